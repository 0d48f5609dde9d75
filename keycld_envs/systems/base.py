"""`System`: everything the library needs to know about a mechanism, declared once as data."""

import copy
import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.checks import (
    check_action_limit,
    check_camera,
    check_choice,
    check_number,
    finite_vector,
    several,
    short,
)
from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism
from keycld_envs.mjcf import check_document, check_step, refused
from keycld_envs.projection import world_to_image

Start = Literal["random", "hanging"]
Reward = Callable[[mujoco.MjModel, mujoco.MjData], float]

LONGEST_FRAME = 1.0
"""Seconds of a control step; in a longer one, no motion can be followed."""
_KINDS = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}


@dataclass(frozen=True)
class Joint:
    """One joint of the mechanism, in MJCF order.

    Attributes:
        name: name in the MJCF.
        kind: "hinge" (rad) or "slide" (m).
        start_range: range of the uniform distribution of random starts, rad or m.
    """

    name: str
    kind: Literal["hinge", "slide"]
    start_range: tuple[float, float]

    def __post_init__(self) -> None:
        check_choice(f"kind of joint {self.name!r}", self.kind, tuple(_KINDS))
        low, high = finite_vector(f"start_range of joint {self.name!r}", self.start_range, 2)
        if low > high:
            raise InputError(f"start_range of joint {self.name!r} runs from {low:g} down to {high:g}; swap them.")


@dataclass(frozen=True)
class Landmark:
    """A landmark fixed to a body, where a learned keypoint is expected.

    Attributes:
        body: name of the body in the MJCF.
        position: position in the body's frame, metres.
        mass_position: if given, point masses at these positions of all landmarks have exactly the mechanism's
            kinetic and potential energy (in a suitable ratio of masses), in the body's frame, metres. The
            keypoints that explain the motion best lie there, which for a thick rod is not its tip.
    """

    body: str
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mass_position: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        finite_vector(f"position of the landmark on {self.body!r}", self.position, 3)


@dataclass(frozen=True)
class Tolerance:
    """When a state counts as being at the target (all at once).

    Attributes:
        angle: greatest angle between any link and its target orientation, rad.
        position: greatest distance of any slide joint from its target, m.
        velocity: bound on every joint speed, rad/s or m/s.
        duration: how long the state must have stayed there, s.
    """

    angle: float = 0.2
    position: float = 0.1
    velocity: float = 0.5
    duration: float = 1.0

    def __post_init__(self) -> None:
        for each in fields(self):
            check_number(f"{each.name} of the tolerance", getattr(self, each.name), 0.0, 1e6)


@dataclass(frozen=True)
class System:
    """A planar mechanism with its simulation model, camera, and target.

    For a mechanism of your own, write an MJCF file with a camera that looks at right angles to the plane of motion,
    declare it like this, and pass it to `KeyCLDEnv(system)` or `register(system, "MyLab/Slider-v0")`::

        System(
            name="slider",
            mjcf=Path("slider.xml"),
            joints=(Joint("rail", "slide", (-0.5, 0.5)),),
            actuators=("push",),
            mechanism=Mechanism(num_keypoints=1, num_actions=1, sliders=(Slider(0),)),
            landmarks=(Landmark("cart"),),
            camera="front",
            timestep=0.02,
            target_qpos=(0.0,),
            hanging_qpos=(0.3,),
        )

    Attributes:
        name: short name, for instance "acrobot".
        mjcf: the MJCF document as text, or the path of an MJCF file.
        joints: all joints, in MJCF order.
        actuators: names of all actuators, in MJCF order.
        mechanism: keypoints, rods and sliders as the world model sees them.
        landmarks: the true keypoints, one per keypoint of the mechanism.
        camera: name of the default camera, which should look along the normal of the plane of motion.
        timestep: control step, s; a whole multiple of the MJCF's own timestep.
        target_qpos: [nq] target configuration, rad or m.
        hanging_qpos: [nq] stable equilibrium, rad or m.
        reward: reward of a state whose derived quantities are up to date; None gives 1 at the target (within
            `tolerance`, whatever the time spent there), 0 elsewhere.
        assets: file name -> content, of files that `mjcf` includes.
        action_limit: default symmetric control limit; None keeps the MJCF's control ranges.
        weak_limit: a tighter symmetric control limit, too weak to lift the links directly, at which benchmarks swing
            the system up as well; None if there is none.
        start: default start.
        tolerance: success criterion.
    """

    name: str
    mjcf: str | Path
    joints: tuple[Joint, ...]
    actuators: tuple[str, ...]
    mechanism: Mechanism
    landmarks: tuple[Landmark, ...]
    camera: str
    timestep: float
    target_qpos: tuple[float, ...]
    hanging_qpos: tuple[float, ...]
    reward: Reward | None = None
    assets: Mapping[str, bytes] = field(default_factory=dict, repr=False, hash=False)
    action_limit: float | None = None
    weak_limit: float | None = None
    start: Start = "random"
    tolerance: Tolerance = Tolerance()

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InputError(f"name of a System must be a text such as 'my_arm', got {short(self.name)}.")
        if not isinstance(self.mjcf, str | Path):
            raise InputError(f"mjcf of system {self.name!r} must be an MJCF text or a Path, got {short(self.mjcf)}.")
        if isinstance(self.mjcf, str) and "<" not in self.mjcf:
            raise InputError(
                f"mjcf of system {self.name!r} is the text {short(self.mjcf)}, which is no XML; for a file, write "
                "mjcf=Path(...)."
            )
        if not isinstance(self.mechanism, Mechanism):
            raise InputError(f"mechanism of system {self.name!r} must be a Mechanism, got {short(self.mechanism)}.")
        for name, kind in (("joints", Joint), ("actuators", str), ("landmarks", Landmark)):
            object.__setattr__(self, name, several(name, getattr(self, name), kind))
        for name in ("target_qpos", "hanging_qpos"):
            value, size = getattr(self, name), len(self.joints)
            if isinstance(value, tuple | list) and not any(isinstance(each, tuple | list) for each in value):
                size = len(value)  # compared with the joints when these are known to be right
            finite_vector(f"{name} of system {self.name!r}", value, size)
        check_number(f"timestep of system {self.name!r}", self.timestep, 0.0, LONGEST_FRAME)
        check_choice(f"start of system {self.name!r}", self.start, get_args(Start))
        for limit in (self.action_limit, self.weak_limit):
            if limit is not None:
                check_action_limit(limit)

    def compile(self) -> mujoco.MjModel:
        """A new model from the MJCF, checked against the declaration.

        Raises:
            InputError: if the MJCF does not compile or a declared name, number or time step disagrees with it.
        """
        try:
            if isinstance(self.mjcf, Path):
                check_document(self.mjcf)
                model = mujoco.MjModel.from_xml_path(str(self.mjcf), dict(self.assets))
            else:
                model = copy.copy(_compile_text(self.mjcf, tuple(self.assets.items())))
        except ValueError as error:
            raise refused(f"The MJCF of system {self.name!r}", error) from error
        check_step(f"The MJCF of system {self.name!r}", model)
        self._check(model)
        model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        return model

    def keypoint_positions(self, model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
        """[K, 3] world positions of the true keypoints, m. Kinematics must be up to date."""
        bodies = [model.body(landmark.body).id for landmark in self.landmarks]
        local = np.array([landmark.position for landmark in self.landmarks])
        return data.xpos[bodies] + np.einsum("kij,kj->ki", data.xmat[bodies].reshape(-1, 3, 3), local)

    def keypoints(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        width: int = 64,
        height: int = 64,
        camera: str | None = None,
    ) -> NDArray[np.float64]:
        """[K, 2] true keypoints in image units (pixel centres span -1 to 1, y up). Kinematics must be up to date."""
        positions = self.keypoint_positions(model, data)
        return world_to_image(model, data, positions, camera or self.camera, width, height)

    def sample_start(self, start: Start, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw the initial qpos [nq] and qvel [nv] of an episode.

        "random" is uniform over the joints' start ranges, at rest. "hanging" is the stable equilibrium with normal
        noise of standard deviation 0.01 on every position and velocity, as in dm_control's cartpole swing-up.
        """
        size = len(self.joints)
        if start == "random":
            low, high = np.transpose([joint.start_range for joint in self.joints])
            return rng.uniform(low, high), np.zeros(size)
        noise = 0.01 * rng.standard_normal((2, size))
        return np.asarray(self.hanging_qpos) + noise[0], noise[1]

    def _check(self, model: mujoco.MjModel) -> None:
        joints = [(model.joint(j).name, model.jnt_type[j]) for j in range(model.njnt)]
        declared = [(joint.name, _KINDS[joint.kind]) for joint in self.joints]
        if joints != declared:
            there = [(name, mujoco.mjtJoint(kind).name.removeprefix("mjJNT_").lower()) for name, kind in joints]
            raise InputError(
                f"System {self.name!r} declares the joints {[(j.name, j.kind) for j in self.joints]}, but its MJCF has "
                f"{there}; name all of them, in its order."
            )
        actuators = tuple(model.actuator(i).name for i in range(model.nu))
        if actuators != self.actuators or len(actuators) != self.mechanism.num_actions:
            raise InputError(
                f"System {self.name!r} declares the actuators {self.actuators} and {self.mechanism.num_actions} "
                f"actions, but its MJCF has the actuators {actuators}; name all of them, in its order, and correct "
                "num_actions."
            )
        if len(self.landmarks) != self.mechanism.num_keypoints:
            raise InputError(
                f"System {self.name!r} declares {len(self.landmarks)} keypoints, but its mechanism has "
                f"{self.mechanism.num_keypoints}; name a landmark for each."
            )
        if not len(self.target_qpos) == len(self.hanging_qpos) == len(self.joints):
            raise InputError(
                f"System {self.name!r} must declare target_qpos and hanging_qpos of length {len(self.joints)}, one "
                "number per joint."
            )
        known = {model.body(b).name for b in range(model.nbody)}
        missing = [landmark.body for landmark in self.landmarks if landmark.body not in known]
        if missing:
            raise InputError(
                f"The MJCF of system {self.name!r} has no body named {missing[0]!r}; it has {sorted(known)}."
            )
        check_camera(model, self.camera)
        substeps = self.timestep / model.opt.timestep
        if round(substeps) < 1 or abs(substeps - round(substeps)) > 1e-6:
            raise InputError(
                f"The time step of system {self.name!r} ({self.timestep} s) is no whole multiple of its MJCF's "
                f"({model.opt.timestep} s); change one of them."
            )


@functools.lru_cache(maxsize=8)
def _compile_text(mjcf: str, assets: tuple[tuple[str, bytes], ...]) -> mujoco.MjModel:
    """Compiling draws the textures anew (60 ms), copying does not (2 ms): never hand out the cached model itself."""
    return mujoco.MjModel.from_xml_string(mjcf, dict(assets))
