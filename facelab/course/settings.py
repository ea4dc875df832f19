"""What may be set at the top of a notebook, and a word for what may not."""

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real


@dataclass(frozen=True)
class Setting:
    """A setting of a notebook: its reference value, and what else it may be.

    Parameters
    ----------
    reference : object
        The value for which the notebook's texts and claims were written.
    choices : sequence, optional
        All values that it may have (of a tuple: that each of its entries may have).
    within : pair of numbers, optional
        Lowest and highest value, both allowed. Where they and the reference are whole, only
        whole numbers are.
    unit : str, default=""

    Examples
    --------
    >>> lam = Setting(0.7, within=(0, 1))
    >>> lam.fault(0.5), lam.fault(2)
    (None, 'is 2; it may be any number from 0 to 1')
    >>> Setting((5, 9), within=(1, 20)).fault((7, 11, 15)) is None
    True
    """

    reference: object
    choices: Sequence | None = None
    within: tuple | None = None
    unit: str = ""

    def fault(self, value):
        """What is wrong with a value, in words that follow the setting's name; None if nothing."""
        many = isinstance(self.reference, tuple)
        if many and (not isinstance(value, list | tuple) or not len(value)):
            return f"is {value!r}; it must be a tuple such as {self.reference!r}"
        bad = [v for v in (value if many else [value]) if not self._allows(v)]
        if not bad:
            return None
        shown = f"holds {', '.join(map(repr, bad))}" if many else f"is {bad[0]!r}"
        return f"{shown}; {'each' if many else 'it'} may be {self.allowed}"

    def _allows(self, value):
        if self.choices is not None:
            return any(type(value) is type(c) and value == c for c in self.choices)
        if self.within is None:
            return True
        kind = int if self._whole else Real
        if not isinstance(value, kind) or isinstance(value, bool):
            return False
        return self.within[0] <= value <= self.within[1]

    @property
    def _whole(self):
        many = self.reference if isinstance(self.reference, tuple) else (self.reference,)
        return all(isinstance(v, int) for v in (*many, *self.within))

    @property
    def allowed(self):
        """What it may be, in words."""
        if self.choices is not None:
            *some, last = map(repr, self.choices)
            return f"{', '.join(some)} or {last}" if some else last
        if self.within is None:
            return "anything"
        low, high = self.within
        unit = f" {self.unit}" if self.unit else ""
        return f"any {'whole ' if self._whole else ''}number from {low} to {high}{unit}"
