"""A case: what a person made of a CT, as values, with the steps that led there; and the file that keeps it."""

from carina.case.document import Document, Key, Keys, Target
from carina.case.history import History, Step
from carina.case.moment import LaidScope, Moment
from carina.case.routes import ChosenRoute

__all__ = ["ChosenRoute", "Document", "History", "Key", "Keys", "LaidScope", "Moment", "Step", "Target"]
