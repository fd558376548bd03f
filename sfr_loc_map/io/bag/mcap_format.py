"""Opcodes and heads of the records of MCAP files (mcap.dev/spec)."""

import struct

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06  #: Opcodes of records.
CHUNK_INDEX, STATISTICS, DATA_END = 0x08, 0x0B, 0x0F
RECORD_HEAD = struct.Struct("<BQ")  #: Opcode and length of a record.
MESSAGE_HEAD = struct.Struct("<HIQQ")  #: Channel, sequence, time of recording, time of publishing.
CHUNK_HEAD = struct.Struct("<QQQI")  #: First and last time, size and checksum (CRC-32) of the content.
CHECKSUM_BYTES = 4
FOOTER_BYTES = 20  #: Offset of the summary, offset of the list of its parts, and a checksum.
FOOTER_SIZE = RECORD_HEAD.size + FOOTER_BYTES
