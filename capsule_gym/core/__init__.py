"""The compiled core, `_core`, its C++ sources, and access to its functions and arrays."""

from importlib.util import find_spec

if find_spec("._core", __package__) is None:
    raise ImportError(
        f"{__path__[0]} contains no compiled core: Python has found a clone's sources. "
        "Use an installed capsule_gym from another folder, "
        "or install the clone with: pip install -e ."
    )
