"""The search for a convention of poses that is not declared (`convention_diagnosis`).

`disagreement` compares the hypotheses of a diagnosis, and `offset_search` searches for an offset of the stamps.
"""
