"""What a source contains (`sfr info`), and the files that describe it (`sfr info --write`, `sfr init`).

facts            pairs, rate, image size, extrinsics, truth and topics of a source
examination      the `Proposal` of an `sfr.yaml`, to which each step adds values and texts
├─► bag_findings      topics (topic_guess), origin and offset of stamps, baseline of a bag
│   └─► topic_guess       the topics by their names in the suite: seen_topics, image_pairs
├─► drive_findings    extrinsics, lever arm and condition of the drive and its truth
└─► proposal          the values with their reasons, and their text
initial_files    initial parameters and limits
"""
