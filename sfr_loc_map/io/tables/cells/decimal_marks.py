"""The commas in the numbers of a table, which separate decimals or thousands."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray

_NUMBER = re.compile(r"[+-]?[0-9.,]*[0-9][0-9.,]*([eE][+-]?[0-9]+)?")
_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(,[0-9]{3})+")  #: A number whose commas may separate thousands.
_BELOW_THOUSAND = re.compile(r"[+-]?[1-9][0-9]{0,2}")
"""A whole number of 1 to 999, which has no thousands separator. If commas were decimal commas, this
number would have three decimals like its neighbours."""


class DecimalMarks:
    """Collects the commas and points in all numbers of a table that is read with decimal commas.

    Three decimals of metres are millimetres, as total stations write them. Three decimals of a smaller unit are not
    plausible.
    """

    def __init__(self, small_unit: str = "") -> None:
        """Judge numbers of which some are in `small_unit`, a unit below a metre; empty if all are in larger units."""
        self._small_unit = small_unit
        self._with_comma = ""  # the first number with a comma; the two below: with a point, and below 1000
        self._with_point = ""
        self._below_thousand = ""
        self._may_be_thousands = True

    def add_cells(self, cells: Iterable[str]) -> None:
        """Add the cells of numbers as written; other texts are ignored."""
        for cell in filter(_NUMBER.fullmatch, cells):
            if "," in cell:
                self._with_comma = self._with_comma or cell
                self._may_be_thousands = self._may_be_thousands and _THOUSANDS.fullmatch(cell) is not None
            if "." in cell:
                self._with_point = self._with_point or cell
            elif _BELOW_THOUSAND.fullmatch(cell):
                self._below_thousand = self._below_thousand or cell

    def add_numbers(self, numbers: FloatArray) -> None:
        """Add numbers that were written without commas."""
        if not self._with_point:
            with_decimals = numbers[numbers != np.floor(numbers)]
            self._with_point = f"{with_decimals[0]:g}" if len(with_decimals) else ""
        if not self._below_thousand:
            below = numbers[(numbers == np.floor(numbers)) & (np.abs(numbers) < 1000.0) & (numbers != 0.0)]
            self._below_thousand = f"{below[0]:g}" if len(below) else ""

    def check(self, name: str) -> None:
        """Raise InputError if the commas in the numbers of a table may separate thousands."""
        other = self._with_point or (self._below_thousand if self._may_be_thousands else "")
        is_small = bool(self._small_unit) and self._may_be_thousands
        if not self._with_comma or not (other or is_small):
            return
        numbers = f"'{self._with_comma}' in {self._small_unit}"
        if other:
            numbers = f"the numbers '{self._with_comma}' and '{other}'"
        raise InputError(
            f"{name} has {numbers}: the comma may separate thousands or decimals: write numbers with a decimal point "
            "and without separators of thousands"
        )
