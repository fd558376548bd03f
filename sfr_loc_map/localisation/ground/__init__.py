"""The ground among the rigid motions in an image: changed cells, evidence, cases, selection and memory."""
