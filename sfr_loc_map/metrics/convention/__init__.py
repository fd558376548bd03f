"""Which single convention mismatch explains that estimate and truth disagree."""
