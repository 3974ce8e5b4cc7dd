"""The blind test of the gap workflow: generate hidden effects, seal the truth, diagnose, and score.

The diagnosis runs in separate processes (`diagnosis.py`) that see recordings only: they can neither import this package
or the simulator nor open the sealed truth.
"""

from __future__ import annotations
