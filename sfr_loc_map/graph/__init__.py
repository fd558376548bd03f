"""Programs that receive the topics of a running graph: the observer of the doctor, and the recorder of bags."""
