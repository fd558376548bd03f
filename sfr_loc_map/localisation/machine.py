"""How the machine code of the localiser is compiled.

`FAST` lets sums be taken in any order, so that they use the processor's vector units: the result depends on the
machine, not on the run. NaN keeps its meaning, as it marks what was not seen.

A function with `FAST` that others call is compiled with `forceinline`: otherwise two copies of it exist, its own and
the one in its caller, which may round differently; the first is called where the caller was just compiled, the second
where it was loaded, and the same pictures would give other last digits on the first run.
"""

FAST = {"reassoc", "contract", "nsz", "arcp"}
