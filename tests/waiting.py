"""How long a test waits for a state that must come."""

from __future__ import annotations

# s; the wait takes milliseconds on an idle machine and seconds on a busy one; this long means failure
PATIENCE = 120.0
