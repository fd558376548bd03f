"""Benchmarks that process one drive or panorama after the other without Dask, so that times can be compared.

    cli/bench.py
      method_benchmark.py     several methods on the pairs of one source: MethodBenchmark, a PassResult for each pass
        trials.py             LocaliserTrial, MapperTrial: open a method, call it with a pair, evaluate its results
        figure_rows.py        figures of a pass as rows, their medians over the passes, and ratios of two methods
      fault_benchmark.py      our localiser with one fault at a time: FaultBenchmark
      provenance.py           version, host, clock and time
      benchmark_tables.py     tables of both results

`content()` of both results is the JSON (`sfr-bench/1`). A pass is one method over all pairs of the source; the key of
the passes in the JSON is `runs`.

To add a figure with its column, add a row to `figures` in trials.py, or to `costs` in method_benchmark.py. To add a
fault, add an entry to `FAULTS` (fault_benchmark.py).
"""
