"""The `Controller` that the environment's argument `controller` names."""

import pkgutil
import re
from collections.abc import Callable
from typing import Any

from capsule_gym.checks import short_repr
from capsule_gym.control.controller import Controller

_OWN = re.compile(r"baselines:[A-Za-z][A-Za-z0-9_]*")


def is_own(controller: str | None) -> bool:
    """Whether an import string names a law of this package: resolving it runs no other code."""
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
    must = (
        "controller must be None, a Controller, a function that returns one, or an import string "
        f"'module:attribute', got {short_repr(controller)}"
    )
    found: Any = controller
    if isinstance(controller, str):
        try:
            if is_own(controller):
                # At the first use: most environments have no law.
                from capsule_gym.control.laws import find_law

                found = find_law(controller.removeprefix("baselines:"))
            else:
                found = pkgutil.resolve_name(controller)
        except (ValueError, AttributeError, ModuleNotFoundError) as error:
            raise ValueError(f"{must}: {error}") from error
    if callable(found):
        try:
            found = found()
        except (TypeError, ValueError) as error:
            kind = TypeError if isinstance(error, TypeError) else ValueError
            raise kind(f"{must}, whose call fails: {error}") from error
    if found is None or isinstance(found, Controller):
        return found
    if found is not controller:
        must += f", which gives {short_repr(found)}"
    raise TypeError(must)
