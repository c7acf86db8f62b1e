"""The command `python -m capsule_gym.export`."""

from pathlib import Path
from typing import Annotated

from capsule_gym.command_line import Positional, arg, check_output, command
from capsule_gym.export.exported import Exported
from capsule_gym.files import write_atomically
from capsule_gym.identification import Excitation

EXCITATION = "excitation"


@command("python -m capsule_gym.export", ImportError, OSError, TypeError, ValueError)
def main(
    policy: Positional[str],
    c: Path | None = None,
    onnx: Path | None = None,
    single: Annotated[bool, arg(name="float")] = False,
    law: bool = False,
    amplitude: float | None = None,
    duration: float | None = None,
    overwrite: bool = False,
) -> None:
    """Exports a trained policy, and the control law that it acts on, as C99 or as ONNX.

    FILE.h of --c has no dependency and allocates nothing; FILE_test.c, next to it, checks it on an
    episode of an evaluation set. A control law of the core, such as baselines:adaptive, is exported
    alone, and so is the excitation for the log of a rig.

    Examples:
      python -m capsule_gym.export direct-ppo --c policy.h
      python -m capsule_gym.export residual-real --c policy.h --float --law
      python -m capsule_gym.export runs/mine --onnx policy.onnx
      python -m capsule_gym.export excitation --amplitude 0.4 --duration 20 --c excitation.h

    Args:
        policy: Name of a pretrained policy, path of a policy file or of a run's folder, import
            string of a control law, or "excitation".
        c: C header to write.
        onnx: ONNX model to write.
        single: Compute in float instead of double, which has the bits of this package.
        law: Export the control law, too.
        amplitude: Root mean square of the excitation's multisine, N m; 0.45 by default.
        duration: Duration of the excitation, s; 20 by default.
        overwrite: Replace existing files.
    """
    if c is None and onnx is None:
        raise ValueError("at least one of --c and --onnx must be given")
    check_output("--c", c, (".h",), overwrite=overwrite)
    test = c and c.with_name(f"{c.stem}_test.c")
    check_output("--c", test, (".c",), overwrite=overwrite)
    check_output("--onnx", onnx, (".onnx",), overwrite=overwrite)
    if policy == EXCITATION:
        excitation = Excitation() if amplitude is None else Excitation(amplitude=amplitude)
        seconds = {} if duration is None else {"seconds": duration}
        exported = Exported(excitation.controller(**seconds))
    else:
        for option, value in (("--amplitude", amplitude), ("--duration", duration)):
            if value is not None:
                raise ValueError(f"{option} is for {EXCITATION!r} alone, got {value} of {policy!r}")
        exported = Exported(policy, law)
    if onnx is not None:
        write_atomically(onnx, exported.onnx(single=single))
    if c is not None and test is not None:
        write_atomically(c, exported.c(single=single))
        write_atomically(test, exported.c_test(c.name, single=single))
