"""Commands on an open case and questions about it; each is one frozen value.

``Case.do`` executes a command. The window sends the same commands as JSON; recordings and files of edits consist of
them::

    from carina.commands import AddTarget, SetTexture

    case.do(SetTexture(on=False))
    case.do(AddTarget((-20.0, 15.0, -180.0)))

Points are LPS mm; angles are in degrees or radians as the name of the field states. ``do`` checks the bounds of the
fields, the constructors do not; a value out of its bounds raises an error with a message.
"""

from carina.commands.case import *  # noqa: F403
from carina.commands.devices import *  # noqa: F403
from carina.commands.flight_recordings import *  # noqa: F403
from carina.commands.flying import *  # noqa: F403
from carina.commands.key_frames import *  # noqa: F403
from carina.commands.look import *  # noqa: F403
from carina.commands.masks import *  # noqa: F403
from carina.commands.plan import *  # noqa: F403
from carina.commands.questions import *  # noqa: F403
from carina.commands.training import *  # noqa: F403
from carina.commands.tree import *  # noqa: F403
from carina.commands.value import Command as Command
from carina.commands.value import FrozenValue, subclasses
from carina.commands.value import all_commands as all_commands
from carina.commands.value import checked as checked

# The names are collected, not listed, so that the definition of a command registers it; `help` and `import *` read
# __all__.
globals()["__all__"] = [
    "Command",
    "all_commands",
    "checked",
    *sorted(
        cls.__name__
        for cls in subclasses(FrozenValue)
        if cls.__module__.startswith("carina.commands.") and cls.__module__ != "carina.commands.value"
    ),
]
