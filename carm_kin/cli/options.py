"""Options that several commands share, or that belong together: one parameter of the command, many options."""

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any, get_type_hints

Command = Callable[..., Any]


def grouped(parameter: str, options: Command) -> Callable[[Command], Command]:
    """Give a command the options of the function ``options`` in place of its ``parameter``, which gets its value."""

    def decorate(command: Command) -> Command:
        own = inspect.signature(command).parameters
        more = {
            name: option.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for name, option in inspect.signature(options).parameters.items()
        }

        @wraps(command)
        def whole(*given: Any, **named: Any) -> Any:
            value = options(**{name: named.pop(name) for name in more})
            return command(*given, **{parameter: value}, **named)

        kept = [option for name, option in own.items() if name != parameter]
        hints = get_type_hints(command, include_extras=True) | get_type_hints(options, include_extras=True)
        whole.__signature__ = inspect.Signature([*kept, *more.values()])  # pyright: ignore[reportAttributeAccessIssue]
        whole.__annotations__ = {name: hint for name, hint in hints.items() if name not in (parameter, "return")}
        return whole

    return decorate
