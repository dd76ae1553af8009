"""Damage to the header of a safetensors file: types, shapes, places and its own length."""

import json
import random
import struct

NUMBERS = [0, 1, 8, 255, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63, 2**64 - 1]
TYPES = ["F64", "F32", "F16", "BF16", "I64", "I32", "U8", "BOOL", "F8_E4M3", "F8_E5M2", "F4", "C64", "x", "", None, []]


def number(old: int, size: int, rng: random.Random) -> int:
    """Return another number of `size` bytes."""
    return rng.choice([*NUMBERS, old - 1, old + 1, 2 * old, old // 2, rng.getrandbits(8 * size)]) % (1 << 8 * size)


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
