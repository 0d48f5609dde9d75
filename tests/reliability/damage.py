"""What fuzz tests damage, how, and what must come of it.

A `Target` is a file, or a set of arguments, that the library reads. It is whole at first; a damage changes it; reading
it then must end in an `InputError`, or in what was written. Text without a checksum, such as a table of numbers, may
also be read as another text of the same kind; a file with checksums may not.
"""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io

from keycld_envs import KeyCLDEnv, get_system
from keycld_envs.collect import CollectSettings
from keycld_envs.effects import EFFECTS
from keycld_envs.recordings import Recording, read_recording, write_recording
from keycld_envs.recordings.importers import Columns, assemble, open_data_set, read_csv, read_mat, read_mcap

Damage = Callable[[bytes, random.Random], bytes]
READER = Callable[[Path], Any]


@dataclass(frozen=True)
class Target:
    """A kind of input.

    Attributes:
        name: of the kind.
        make: writes it whole into a folder, and names the file to damage.
        read: reads it, from the folder; what it returns can be compared.
        sealed: it has checksums, so that nothing else than what was written may be read.
    """

    name: str
    make: Callable[[Path], Path]
    read: READER
    sealed: bool


def flip(content: bytes, rng: random.Random) -> bytes:
    """Some bytes are others."""
    out = bytearray(content)
    for _ in range(rng.choice([1, 1, 2, 8, 64])):
        if out:
            out[rng.randrange(len(out))] ^= rng.randrange(1, 256)
    return bytes(out)


def cut(content: bytes, rng: random.Random) -> bytes:
    """The end is missing."""
    return content[: rng.randrange(len(content) + 1)]


def drop(content: bytes, rng: random.Random) -> bytes:
    """A piece in the middle is missing."""
    a, b = sorted((rng.randrange(len(content) + 1), rng.randrange(len(content) + 1)))
    return content[:a] + content[b:]


def zero(content: bytes, rng: random.Random) -> bytes:
    """A block was never written."""
    a = rng.randrange(len(content) + 1)
    b = min(len(content), a + rng.choice([1, 16, 512, 4096]))
    return content[:a] + bytes(b - a) + content[b:]


def repeat(content: bytes, rng: random.Random) -> bytes:
    """A piece comes twice."""
    a, b = sorted((rng.randrange(len(content) + 1), rng.randrange(len(content) + 1)))
    return content[:b] + content[a:b] + content[b:]


def insert(content: bytes, rng: random.Random) -> bytes:
    """Something else stands in it."""
    a = rng.randrange(len(content) + 1)
    return content[:a] + rng.choice(INTRUDERS) + content[a:]


def replace_all(content: bytes, rng: random.Random) -> bytes:
    """Another file has its name."""
    return rng.choice(OTHERS)


def number(content: bytes, rng: random.Random) -> bytes:
    """A number of a text is another one."""
    digits = [i for i, byte in enumerate(content) if 48 <= byte < 58]
    if not digits:
        return flip(content, rng)
    a = b = rng.choice(digits)
    while b < len(content) and 48 <= content[b] < 58:
        b += 1
    return content[:a] + rng.choice(NUMBERS) + content[b:]


DAMAGES: dict[str, Damage] = {
    "flip": flip, "cut": cut, "drop": drop, "zero": zero, "repeat": repeat, "insert": insert, "replace": replace_all,
    "number": number,
}  # fmt: skip
NUMBERS = [
    b"-1",
    b"0",
    b"1e999",
    b"NaN",
    b"1e-320",
    b"9" * 400,
    b"2147483648",
    b"-9223372036854775809",
    b"1e9",
    b"null",
]
INTRUDERS = [
    b"\0", b"\xff\xfe", b'"', b"'" * 3, b"[" * 9000, b"{" * 20_000, b"," * 5000, b";\n" * 50, b"\r", b"1" * 200_000,
    "\u202e\u0000\U0001f600".encode(), b"<!--", b"]]>", b"&lt;", b"nan", b"-inf", b"1e400", b"\x93NUMPY", b"PK\x05\x06",
]  # fmt: skip
OTHERS = [
    b"", b"\0" * 4096, b"[" * 100_000, b"\x89PNG\r\n\x1a\n" + b"\0" * 100, b"PK\x05\x06" + bytes(18),
    b"MATLAB 5.0 MAT-file", b"{}", b"null", b"<mujoco/>", struct.pack("<Q", 2**62) + b"{}", "ä".encode("utf-16"),
]  # fmt: skip


def _recording(folder: Path, video: bool = False) -> Path:
    rng, t = np.random.default_rng(0), 0.02 * np.arange(12, dtype=np.float64)
    write_recording(
        folder / "run",
        Recording(
            id="run", source="simulation", system="KeyCLD/Pendulum-v0", joint_names=("hinge",),
            actuator_names=("torque",), units={"qpos": "rad", "action": "N m"},
            camera={"width": 16, "height": 16}, t_action=t, action=rng.normal(size=(12, 1)), t_state=t,
            qpos=rng.normal(size=(12, 1)), t_frame=t, frames=rng.integers(0, 255, (12, 16, 16, 3)).astype(np.uint8),
        ),
        video=video,
    )  # fmt: skip
    return folder / "run"


def _read_recording(folder: Path) -> Any:
    r = read_recording(folder / "run")
    arrays = [getattr(r, name) for name in ("t_action", "action", "t_state", "qpos", "t_frame")]
    return [None if a is None else a.tobytes() for a in arrays], [frame.tobytes() for frame in r.iter_frames()]


def _table(folder: Path) -> Path:
    rng, path = np.random.default_rng(1), folder / "log.csv"
    rows = [f"{0.01 * k:.2f},{q:.5f},{u:.3f}" for k, (q, u) in enumerate(rng.normal(size=(40, 2)))]
    path.write_text("t,angle,torque\n" + "\n".join(rows) + "\n")
    return path


def _read_table(folder: Path) -> Any:
    table = read_csv(folder / "log.csv")
    r = assemble(table, Columns("t", {"hinge": "angle"}, actions={"motor": "torque"}, units={"angle": "deg"}), "log")
    return np.asarray(r.qpos).tobytes(), np.asarray(r.action).tobytes()


def _matlab(folder: Path, compressed: bool) -> Path:
    rng, path = np.random.default_rng(2), folder / "log.mat"
    cells = np.empty(2, object)
    cells[:] = [rng.normal(size=(30, 2)), rng.normal(size=(5, 1))]
    content = {"t": 0.01 * np.arange(30), "Y": cells, "s": {"u": rng.normal(size=30)}, "note": "words"}
    io.savemat(path, content, do_compression=compressed)
    return path


def _read_matlab(folder: Path) -> Any:
    return {name: column.tobytes() for name, column in read_mat(folder / "log.mat").columns.items()}


def _model(folder: Path) -> Path:
    path, xml = folder / "arm.xml", get_system("acrobot").mjcf
    path.write_text(xml if isinstance(xml, str) else xml.read_text())
    for name, content in get_system("acrobot").assets.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return path


def _read_model(folder: Path) -> Any:
    from keycld_model.diagnosis import Source

    model = Source.of_file(folder / "arm.xml").model
    return model.body_mass.tobytes(), model.dof_damping.tobytes(), model.actuator_gear.tobytes()


def _checkpoint(folder: Path) -> Path:
    from swinging import CONFIG, random_parameters  # pyright: ignore[reportMissingImports]

    from keycld_model import WorldModel

    WorldModel(CONFIG, random_parameters(CONFIG), "a model", {"seed": 3}).save(folder / "model")
    return folder / "model" / "weights.safetensors"


def _read_checkpoint(folder: Path) -> Any:
    from keycld_model import WorldModel
    from keycld_model.checkpoint import flatten

    return {name: array.tobytes() for name, array in flatten(WorldModel.load(folder / "model").parameters).items()}


def _state(folder: Path) -> Path:
    from swinging import CONFIG, random_parameters  # pyright: ignore[reportMissingImports]

    from keycld_model.checkpoint import write_checkpoint

    tensors = {"variables": random_parameters(CONFIG), "optimiser": {"0000": np.zeros(3, np.float32)}}
    write_checkpoint(folder / "state", tensors, {"stage": 1, "done": 2, "step": 8, "seconds": 1.0})
    return folder / "state" / "weights.safetensors"


def _read_state(folder: Path) -> Any:
    from keycld_model.checkpoint import flatten, read_checkpoint

    tensors, meta = read_checkpoint(folder / "state")
    return {name: array.tobytes() for name, array in flatten(tensors).items()}, json.dumps(meta)


def _joint_archive(folder: Path) -> Path:
    path, t = folder / "letters.npz", 0.02 * np.arange(40)
    q, v = (np.stack([f(3 * t), f(2 * t)], axis=1) for f in (np.sin, np.cos))
    signals: dict[str, Any] = {"qp": q, "qv": v * [3.0, 2.0], "qa": -q * [9.0, 4.0], "tau": q + v}
    np.savez(path, t=t, labels=np.array(["a", "b"]), lengths=np.array([20, 20]), **signals)
    return path


def _read_joint_archive(folder: Path) -> Any:
    from keycld_model.delan import read_motions

    motions = read_motions(folder / "letters.npz")
    return motions.sha256, motions.ids, motions.scales()


def _joint_model(folder: Path) -> Path:
    from keycld_model.delan import JointConfig, JointModel
    from keycld_model.delan.config import Scales
    from keycld_model.delan.families import JointDynamics

    config = JointConfig(("a",), ("hinge",), Scales(*(((1.0,),) * 5)), width=3, depth=1, friction=("viscous_friction",))
    JointModel(config, JointDynamics(config).initial(0)).save(folder / "arm")
    return folder / "arm" / "weights.safetensors"


def _read_joint_model(folder: Path) -> Any:
    from keycld_model.checkpoint import flatten
    from keycld_model.delan import JointModel

    model = JointModel.load(folder / "arm")
    return model.config, {name: array.tobytes() for name, array in flatten(model.parameters).items()}


def _mcap(folder: Path) -> Path:
    from mcap.writer import Writer

    with open(folder / "log.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/arm", "json", writer.register_schema("arm", "jsonschema", b"{}"))
        for i in range(20):
            writer.add_message(channel, 10**7 * i, json.dumps({"q": [i, -i]}).encode(), 10**7 * i)
        writer.finish()
    return folder / "log.mcap"


def _lerobot(folder: Path) -> Path:
    from keycld_envs.recordings.exporters import write_lerobot

    write_lerobot([read_recording(_recording(folder))], folder / "set")
    return folder / "set/data/chunk-000/file-000.parquet"


def _member(folder: Path, name: str) -> Path:
    return _recording(folder) / name


TARGETS = (
    Target("recording: signals", lambda folder: _member(folder, "signals.npz"), _read_recording, True),
    Target("recording: frames", lambda folder: _member(folder, "frames.npz"), _read_recording, True),
    Target("recording: description", lambda folder: _member(folder, "meta.json"), _read_recording, False),
    Target("recording: video", lambda folder: _recording(folder, True) / "frames.mkv", _read_recording, True),
    Target("checkpoint", _checkpoint, _read_checkpoint, True),
    Target("state of a training", _state, _read_state, True),
    Target("joint model", _joint_model, _read_joint_model, True),
    Target("archive of joints", _joint_archive, _read_joint_archive, False),
    Target("CSV", _table, _read_table, False),
    Target("MATLAB", lambda folder: _matlab(folder, False), _read_matlab, False),
    Target("MATLAB, compressed", lambda folder: _matlab(folder, True), _read_matlab, False),
    Target("MCAP", _mcap, lambda folder: repr(read_mcap(folder / "log.mcap").columns), False),
    Target("LeRobot", _lerobot, lambda folder: [repr(e.recording()) for e in open_data_set(folder / "set")], False),
    Target("MJCF", _model, _read_model, False),
)
ODD: list[Any] = [
    None, True, "a", "", b"x", -1, 0, 1e999, float("nan"), 10**400, -(10**400), [], {}, [[1.0]], (1, "2"), object(),
    np.array("x"), np.zeros((2, 2)), np.array([np.nan, 1.0]), 1j, {"a": 1, 2: 3}, [None], "\u202e", 2**63, 1e-320,
]  # fmt: skip


def try_options(rng: random.Random) -> None:
    """Build and use something with odd arguments; it must work, or raise `InputError`."""
    odd = rng.choice(ODD)
    name = rng.choice(["pendulum", "cartpole", "acrobot"])
    what = rng.choice(["env", "reset", "step", "effect", "collect", "columns", "render"])
    if what == "env":
        option = rng.choice(
            ["obs_type", "width", "height", "camera", "render_quality", "action_limit", "start", "render_mode"]
        )
        KeyCLDEnv(name, **{"obs_type": "state", option: odd})
    elif what == "collect":
        option = rng.choice(["env_id", "steps", "policy", "action_range", "velocity", "width", "height", "seed"])
        CollectSettings(**{"env_id": name, option: odd})
    elif what == "columns":
        field = rng.choice(["time", "joints", "velocities", "actions", "action_time", "units"])
        table = read_csv(_table(Path(OPTIONS_FOLDER)))
        assemble(table, Columns(**{"time": "t", "joints": {"hinge": "angle"}, field: odd}), "x")
    else:
        env = KeyCLDEnv(name, obs_type="state", effects=_odd_effect(rng, name, odd) if what == "effect" else ())
        if what == "reset":
            options: Any = odd if rng.random() < 0.3 else {rng.choice(["qpos", "qvel", 3, "x"]): odd}
            env.reset(options=options)
            env.step(np.zeros(env.model.nu))
            return
        env.reset(seed=0)
        if what == "render":
            env.render_qpos(odd)
        for _ in range(3):
            env.step(odd if what == "step" else np.zeros(env.model.nu))


OPTIONS_FOLDER = "."
"""Where `try_options` may write."""


def _odd_effect(rng: random.Random, system: str, odd: Any) -> list[Any]:
    """An effect with an odd number, or something that is none."""
    model = get_system(system).compile()
    known = [kind for kind in EFFECTS.values() if kind.candidates(model)]
    kind = rng.choice(known)
    candidate = rng.choice(kind.candidates(model))
    numbers = [p.name for p in candidate.parameters()]
    if rng.random() < 0.1 or not numbers:
        return [odd]
    value = rng.choice([odd, -5.0, 1e9, float("nan"), 1e-300])
    return [type(candidate)(**{**vars(candidate), rng.choice([*numbers, "where"]): value})]
