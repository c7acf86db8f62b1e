"""The compiled core, `_core`, its C++ sources, and access to its functions and arrays."""

import sysconfig
from importlib.util import find_spec

if sysconfig.get_config_var("Py_GIL_DISABLED"):
    raise ImportError(
        "capsule_gym needs CPython with its global lock: "
        "free-threaded Pythons do not load its module, which has the stable ABI"
    )
if find_spec("._core", __package__) is None:
    raise ImportError(
        f"{__path__[0]} contains no compiled core: Python has found a clone's sources. "
        "Use an installed capsule_gym from another folder, "
        "or install the clone with: pip install -e ."
    )
