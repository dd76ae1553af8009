"""Damage to the fields of containers: lengths, counts, offsets, types and the order of parts, with right checksums."""

import json
import random
import struct
import zlib

NUMBERS = [
    0,
    1,
    2,
    3,
    8,
    16,
    255,
    256,
    65535,
    65536,
    10**6,
    2**24,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**40,
    2**63,
    2**64 - 1,
]
CHUNKS = [b"IHDR", b"PLTE", b"tRNS", b"iCCP", b"zTXt", b"iTXt", b"eXIf", b"acTL", b"fcTL", b"fdAT", b"IDAT", b"IEND"]
TYPES = ["F64", "F32", "F16", "BF16", "I64", "I32", "U8", "BOOL", "F8_E4M3", "F8_E5M2", "F4", "C64", "x", "", None, []]


def number(old: int, size: int, rng: random.Random) -> int:
    """Return another number of `size` bytes."""
    return rng.choice([*NUMBERS, old - 1, old + 1, 2 * old, old // 2, rng.getrandbits(8 * size)]) % (1 << 8 * size)


def change_field(content: bytes, rng: random.Random, at: int | None = None, kind: str | None = None) -> bytes:
    """Put another number into a field, or into any place, mostly of the first 300 bytes."""
    kind = kind or rng.choice("<>") + rng.choice("BHHIIIQ")
    size = struct.calcsize(kind)
    if len(content) < size:
        return content
    if at is None:
        at = rng.randrange(len(content) if rng.random() < 0.3 else min(300, len(content)))
    at = min(at, len(content) - size)
    (old,) = struct.unpack_from(kind, content, at)
    return content[:at] + struct.pack(kind, number(old, size, rng)) + content[at + size :]


def png(content: bytes, rng: random.Random) -> bytes:
    """Change, add, repeat, drop or swap chunks; change the packed pixels, or the length of a chunk."""
    chunks, at = [], 8
    while at < len(content):
        (size,) = struct.unpack_from(">I", content, at)
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + size]))
        at += 12 + size
    k = rng.randrange(len(chunks))
    name, data = chunks[k]
    action = rng.randrange(6)
    if action == 0:
        chunks[0] = (
            b"IHDR",
            change_field(chunks[0][1], rng, *rng.choice([(0, ">I"), (4, ">I"), (rng.randrange(8, 13), "B")])),
        )
    elif action == 1:
        data = rng.choice([b"", bytes(rng.choice((1, 13, 26, 1000))), rng.randbytes(26), zlib.compress(bytes(10**6))])
        chunks.insert(k, (rng.choice(CHUNKS), rng.choice([data, b"a\0\0" + data])))
    elif action == 2:
        chunks[k : k + 1] = rng.choice([[], [(name, data)] * rng.choice((2, 100)), [(rng.choice(CHUNKS), data)]])
    elif action == 3:
        rng.shuffle(chunks)
    elif action == 4:
        rows = zlib.decompress(b"".join(data for name, data in chunks if name == b"IDAT"))
        rows = rng.choice([rows[: len(rows) // 2], rows * 50, bytes(10**6), change_field(rows, rng)])
        chunks = [part for part in chunks if part[0] != b"IDAT"]
        chunks.insert(1, (b"IDAT", zlib.compress(rows)))
    packed = [struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in chunks]
    if action == 5:
        packed[k] = change_field(packed[k], rng, 0, ">I")
    return content[:8] + b"".join(packed)


def tiff(content: bytes, rng: random.Random) -> bytes:
    """Change a field of a directory, or where it leads to."""
    order = "<" if content[:2] == b"II" else ">"
    starts, (at,) = [], struct.unpack_from(order + "I", content, 4)
    while at and at not in starts:
        starts.append(at)
        (entries,) = struct.unpack_from(order + "H", content, at)
        (at,) = struct.unpack_from(order + "I", content, at + 2 + 12 * entries)
    start = rng.choice(starts)
    (entries,) = struct.unpack_from(order + "H", content, start)
    action = rng.random()
    if action < 0.1:
        return change_field(content, rng, start, order + "H")
    after = start + 2 + 12 * entries
    if action < 0.25:
        target = rng.choice([*starts, 4, 8, after, rng.randrange(len(content))])
        return content[:after] + struct.pack(order + "I", target) + content[after + 4 :]
    entry = start + 2 + 12 * rng.randrange(entries)
    return change_field(
        content,
        rng,
        *rng.choice(
            [
                (entry, order + "H"),
                (entry + 2, order + "H"),
                (entry + 4, order + "I"),
                (entry + 8, order + "I"),
                (entry + 8, order + "H"),
            ]
        ),
    )


def jpeg(content: bytes, rng: random.Random) -> bytes:
    """Change, repeat, drop or swap segments; change a field of one."""
    segments, at = [], 2
    while content[at + 1] != 0xDA:
        (size,) = struct.unpack_from(">H", content, at + 2)
        segments.append(content[at : at + 2 + size])
        at += 2 + size
    (size,) = struct.unpack_from(">H", content, at + 2)
    header, scan = content[at : at + 2 + size], content[at + 2 + size : -2]
    k = rng.randrange(len(segments))
    action = rng.randrange(5)
    if action == 0:
        segments[k] = change_field(segments[k], rng, rng.randrange(1, len(segments[k])), rng.choice(["B", ">H"]))
    elif action == 1:
        header = change_field(header, rng, rng.randrange(2, len(header)), "B")
    elif action == 2:
        segments[k : k + 1] = rng.choice([[], [segments[k]] * rng.choice((2, 50))])
    elif action == 3:
        rng.shuffle(segments)
    repeated = rng.choice((2, 50, 2000)) if action == 4 else 1
    return (
        content[:2]
        + b"".join(segments)
        + (header + rng.choice([scan, b""])) * (repeated - 1)
        + header
        + scan
        + b"\xff\xd9"
    )


def safetensors(content: bytes, rng: random.Random) -> bytes:
    """Change the type, shape or place of a tensor, or what the header says of its own length."""
    (length,) = struct.unpack("<Q", content[:8])
    header, values = json.loads(content[8 : 8 + length]), content[8 + length :]
    name = rng.choice([name for name in header if name != "__metadata__"])
    entry = header[name]
    action = rng.randrange(6)
    if action == 0:
        entry["dtype"] = rng.choice(TYPES)
    elif action == 1:
        entry["shape"] = rng.choice([[], [0], [0, 2**62], [-1], [2**63], entry["shape"][::-1], [1] * 1000, [1.5], None])
    elif action == 2:
        place = rng.randrange(2)
        entry["data_offsets"][place] = number(entry["data_offsets"][place], 8, rng)
    elif action == 3:
        header[rng.choice(["x", "", "network", "optimizer.0", "optimizer.x.step", "__metadata__"])] = entry
    elif action == 4:
        header["__metadata__"]["about"] = rng.choice(
            ["[" * 10**5, "[" * 500 + "]" * 500, '{"config": ' * 300 + "1" + "}" * 300]
        )
    packed = json.dumps(header).encode()
    size = number(len(packed), 8, rng) if action == 5 else len(packed)
    return struct.pack("<Q", size) + packed + values
