"""What a source contains (`sfr info`), and the files that describe it (`sfr info --write`, `sfr init`).

facts            pairs, rate, image size, extrinsics, truth and topics of a source
proposal         an `sfr.yaml`, whose values are inferred step by step
└─► topic_guess      the topics of a bag by their names in the suite
└─► seen_topics, image_pairs, joint_images, truth_topics      the steps of this inference
initial_files    initial parameters and limits
"""
