"""How the machine code of the localiser is compiled.

`FAST` lets sums be taken in any order, so that they use the processor's vector units: the result depends on the
machine, not on the run. NaN keeps its meaning, as it marks what was not seen.
"""

FAST = {"reassoc", "contract", "nsz", "arcp"}
