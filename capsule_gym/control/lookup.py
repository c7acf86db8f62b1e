"""The `Controller` that the environment's argument `controller` names."""

import pkgutil
import re
from collections.abc import Callable
from typing import Any

from capsule_gym.checks import short_repr
from capsule_gym.control.controller import Controller
from capsule_gym.control.laws import find_law

_OWN = re.compile(r"baselines:[A-Za-z][A-Za-z0-9_]*")


def is_own(controller: str | None) -> bool:
    """Whether an import string names a law that comes with this package: resolving it runs no other
    code.
    """
    return controller is None or _OWN.fullmatch(controller) is not None


def find_controller(
    controller: str | Controller | Callable[[], Controller] | None,
) -> Controller | None:
    """Returns the `Controller` for the environment's argument `controller`.

    The package itself knows the laws that it contains: another package named `baselines` does not
    hide them.

    Raises:
        TypeError: if the argument or the object that it names is not of an accepted type.
        ValueError: if the import string names a module or attribute that does not exist.
    """
    if isinstance(controller, Controller):
        # Before the texts of errors, for which its whole table would be printed.
        return controller
    accepted = (
        "None, a Controller, a function that returns one, or an import string 'module:attribute'"
    )
    must = f"controller must be {accepted}, got {short_repr(controller)}"
    found: Any = controller
    if isinstance(controller, str):
        try:
            found = (
                find_law(controller.partition(":")[2])
                if is_own(controller)
                else pkgutil.resolve_name(controller)
            )
        except (ValueError, AttributeError, ModuleNotFoundError) as error:
            raise ValueError(f"{must}: {error}") from error
    if callable(found):
        try:
            found = found()
        except (TypeError, ValueError) as error:
            kind = TypeError if isinstance(error, TypeError) else ValueError
            raise kind(f"{must}, whose call fails: {error}") from error
    if found is not None and not isinstance(found, Controller):
        raise TypeError(must if found is controller else f"{must}, which gives {short_repr(found)}")
    return found
