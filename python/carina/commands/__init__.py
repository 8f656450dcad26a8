"""What can be asked of an open case: each command is one frozen value.

``Case.do`` does one, and the window sends the same ones as JSON; recordings and files of edits are made of them too::

    from carina.commands import AddTarget, SetTexture

    case.do(SetTexture(on=False))
    case.do(AddTarget((-20.0, 15.0, -180.0)))

Points are LPS mm, angles degrees or radians as the field says. Bounds are looked at by ``do`` and not by the
constructors; what is out of them is refused in words.
"""

from carina.commands.case import *  # noqa: F403
from carina.commands.devices import *  # noqa: F403
from carina.commands.flights import *  # noqa: F403
from carina.commands.flying import *  # noqa: F403
from carina.commands.key_frames import *  # noqa: F403
from carina.commands.look import *  # noqa: F403
from carina.commands.masks import *  # noqa: F403
from carina.commands.plan import *  # noqa: F403
from carina.commands.questions import *  # noqa: F403
from carina.commands.tree import *  # noqa: F403
from carina.commands.value import Command as Command
from carina.commands.value import FrozenValue, subclasses
from carina.commands.value import all_commands as all_commands
from carina.commands.value import checked as checked

# Found and not listed, so that writing a command is registering it; `help` and `import *` read this.
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
