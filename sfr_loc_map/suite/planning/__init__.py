"""From the file of a suite to its plan.

specification.py        parses and checks the file, and finds its sources: SuiteSpecification
  source_entries.py     finds the sources of each entry of `sources`, and gives them unique names
  variants.py           the variants of a scenario that an error budget requires
source_inspection.py    reads and hashes the data of a source
drive_copies.py         finds the sources that show the same drive
plan.py                 combines sources, tasks, faults, configurations and repeats: Plan, a list of Job
data_set.py             compares the data with the hashes in the limits
"""
