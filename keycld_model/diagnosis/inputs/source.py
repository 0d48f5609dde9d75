"""Where a simulator comes from: its model, and the MJCF behind it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import mujoco

from keycld_envs.errors import InputError
from keycld_envs.mjcf import check_document, check_step, refused
from keycld_envs.registration import make, resolve_env_id


@dataclass(frozen=True)
class Source:
    """A simulator.

    Attributes:
        model: compiled.
        mjcf: the MJCF file, or text; None if the environment does not tell.
        assets: files that `mjcf` includes or refers to, by name.
        environment: id of the environment, None for a file.
    """

    model: mujoco.MjModel
    mjcf: Path | str | None
    assets: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    environment: str | None = None

    @classmethod
    def of_file(cls, path: Path) -> "Source":
        """A MuJoCo XML file; bodies, joints and actuators without a name get one, such as "body_2".

        Raises:
            InputError: if it does not compile.
        """
        check_document(path)
        try:
            source = cls(mujoco.MjModel.from_xml_path(str(path)), path)
            if unnamed(source.model) is not None:
                source = cls(source.spec().compile(), path)
        except (ValueError, RuntimeError) as error:
            raise refused(str(path), error) from error
        check_step(str(path), source.model)
        return source

    @classmethod
    def of_environment(cls, name: str, action_limit: float | None = None) -> "Source":
        """A Gymnasium environment on MuJoCo: of KeyCLD, or any whose `model` is an MjModel.

        Args:
            name: its id, or the short name of a system.
            action_limit: symmetric range of every motor of an environment of KeyCLD; None is its own.

        Raises:
            InputError: if there is none of that name, or it has no such model.
        """
        env_id = resolve_env_id(name)
        env = make(env_id, **({} if action_limit is None else {"action_limit": action_limit})).unwrapped
        model = getattr(env, "model", None)
        if not isinstance(model, mujoco.MjModel):
            raise InputError(f"The environment {env_id} has no MuJoCo model; name another, or an MJCF file by --mjcf.")
        system, path = getattr(env, "system", None), getattr(env, "fullpath", None)
        if system is not None:
            return cls(model, system.mjcf, system.assets, env_id)
        return cls(model, None if path is None else Path(path), {}, env_id)

    @classmethod
    def of(cls, mjcf: Path | None, environment: str | None, action_limit: float | None = None) -> "Source":
        """A file if there is one, else an environment; see `of_environment`.

        Raises:
            InputError: if there is neither, or it cannot be used.
        """
        if mjcf is not None:
            return cls.of_file(mjcf)
        if environment is None:
            raise InputError(
                "The recordings name no environment; say which simulator to compare with, --env or --mjcf."
            )
        return cls.of_environment(environment, action_limit)

    def spec(self) -> mujoco.MjSpec:
        """The MJCF, for editing; every body, joint and actuator has a name.

        Raises:
            InputError: if the MJCF is not known.
        """
        if self.mjcf is None:
            raise InputError(f"The environment {self.environment} does not tell its MJCF; name the file by --mjcf.")
        included = {name: content for name, content in self.assets.items() if name.endswith(".xml")}
        others = {name: content for name, content in self.assets.items() if name not in included}
        if isinstance(self.mjcf, Path):
            spec = mujoco.MjSpec.from_file(str(self.mjcf), include=included, assets=others)
            folder = self.mjcf.resolve().parent
            spec.meshdir, spec.texturedir = str(folder / spec.meshdir), str(folder / spec.texturedir)
        else:
            spec = mujoco.MjSpec.from_string(self.mjcf, include=included, assets=others)
        for kind, elements in (("body", spec.bodies), ("joint", spec.joints), ("actuator", spec.actuators)):
            taken = {element.name for element in elements}
            for i, element in enumerate(elements):
                name = f"{kind}_{i}"
                while name in taken:
                    name += "_"
                element.name = element.name or name
        return spec


def unnamed(model: mujoco.MjModel) -> str | None:
    """The first body, joint or actuator without a name, such as "body 2"; None if all have one."""
    kinds = {
        "body": (model.nbody, model.body),
        "joint": (model.njnt, model.joint),
        "actuator": (model.nu, model.actuator),
    }
    for kind, (number, element) in kinds.items():
        for i in range(number):
            if not element(i).name:
                return f"{kind} {i}"
    return None
