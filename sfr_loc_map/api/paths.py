"""What the functions of the API take for a file or folder."""

from __future__ import annotations

import os

PathLike = str | os.PathLike[str]
