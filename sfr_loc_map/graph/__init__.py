"""Programs that join a running graph to receive its topics, and publish nothing.

sfr doctor    observer.GraphObserver (some seconds)   ──► doctor.observation.Observation ──► doctor.examination
sfr record    record.record (until a signal)          ──► a bag
"""
