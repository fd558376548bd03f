"""The rules for stamps in files and bags, which tables, truths and layouts share.

`stamp_text` converts stamps in text to nanoseconds, `time_units` infers their unit, and `stamp_checks` decides which
stamps are stray, out of order or in another unit. `message_stamps` has the rules for running nodes, and `stamp_pairing`
pairs the stamps of two topics.
"""
