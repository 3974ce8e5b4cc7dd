"""The blind test of the gap workflow: a generator of hidden effects, a sealing, and a scorer.

The diagnosis runs in processes of its own (`diagnosis.py`) that see recordings only: they can import neither
this package nor the simulator, nor open the sealed truth.
"""

from __future__ import annotations
