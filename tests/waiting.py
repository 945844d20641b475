"""How long a test waits for a state that it knows must come."""

from __future__ import annotations

# s; a blink on an idle machine, some seconds on a busy one, and whoever waits this long waits in vain
PATIENCE = 120.0
