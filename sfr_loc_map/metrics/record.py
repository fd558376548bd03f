"""The base of all records: frozen structs that msgspec writes as JSON and reads, with checks of their types."""

from __future__ import annotations

import msgspec


class Record(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """Base of everything that is written as JSON."""
