"""Prefix codes of deflate: lengths from how often symbols occur, codes from lengths, and how lengths are written.

Format: RFC 1951, P. Deutsch, 1996.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import I32, I64, U64
from sppm_pipeline.services.jit.compiled import jit

LONGEST_CODE, LONGEST_OF_LENGTHS = 15, 7
"""Bits of the longest code, and of the longest in which lengths are written."""


def code_lengths(counts: I64, longest: int) -> I32:
    """Lengths of a prefix code for symbols that occur so often, at most `longest`; 0 for those that don't."""
    # keys are all different, so that any way of sorting gives the same order
    keys = np.sort(counts * 512 + np.arange(counts.size))
    return _lengths(keys[keys >= 512], counts.size, longest)


@jit
def _lengths(keys: I64, symbols: int, longest: int) -> I32:
    """The same from 512 times the count, plus the symbol, in ascending order."""
    lengths = np.zeros(symbols, np.int32)
    n = keys.size
    if n < 2:
        for key in keys:
            lengths[key % 512] = 1
        return lengths
    # Huffman's tree: the leaves in order, and the nodes in the order in which they are made, are two sorted queues
    weight = np.empty(2 * n - 1, np.int64)
    parent = np.zeros(2 * n - 1, np.int64)
    weight[:n] = keys // 512
    leaf, node = 0, n
    for made in range(n, 2 * n - 1):
        total = 0
        for _ in range(2):
            if leaf < n and (node == made or weight[leaf] <= weight[node]):
                child = leaf
                leaf += 1
            else:
                child = node
                node += 1
            parent[child] = made
            total += weight[child]
        weight[made] = total
    depth = np.zeros(2 * n - 1, np.int64)
    of_length = np.zeros(longest + 1, np.int64)
    for i in range(2 * n - 3, -1, -1):
        depth[i] = depth[parent[i]] + 1
        if i < n:
            of_length[min(depth[i], longest)] += 1
    kraft = 0
    for length in range(1, longest + 1):
        kraft += of_length[length] << (longest - length)
    while kraft > 1 << longest:
        of_length[longest] -= 1
        length = longest - 1
        while of_length[length] == 0:
            length -= 1
        of_length[length] -= 1
        of_length[length + 1] += 2
        kraft -= 1
    i = 0  # the rarest symbols get the longest codes
    for length in range(longest, 0, -1):
        for _ in range(of_length[length]):
            lengths[keys[i] % 512] = length
            i += 1
    return lengths


@jit
def prefix_codes(lengths: I32) -> U64:
    """The canonical codes of some lengths (RFC 1951, section 3.2.2), their first bit lowest."""
    codes = np.zeros(lengths.size, np.uint64)
    code = 0
    for length in range(1, LONGEST_CODE + 1):
        code <<= 1
        for symbol in range(lengths.size):
            if lengths[symbol] == length:
                turned = 0
                for bit in range(length):
                    turned |= (code >> bit & 1) << (length - 1 - bit)
                codes[symbol] = turned
                code += 1
    return codes


@jit
def lengths_packed(lengths: I32) -> tuple[I32, I32]:
    """The lengths of codes as symbols with extra values: 16 repeats the last, 17 and 18 are zeros (section 3.2.7)."""
    symbols = np.zeros(lengths.size, np.int32)
    extras = np.zeros(lengths.size, np.int32)
    n = i = 0
    while i < lengths.size:
        value = lengths[i]
        run = 1
        while i + run < lengths.size and lengths[i + run] == value:
            run += 1
        i += run
        if value != 0:
            symbols[n] = value
            n += 1
            run -= 1
        most = 138 if value == 0 else 6
        while run >= 3:
            part = min(run, most)
            if value != 0:
                symbols[n], extras[n] = 16, part - 3
            elif part <= 10:
                symbols[n], extras[n] = 17, part - 3
            else:
                symbols[n], extras[n] = 18, part - 11
            n += 1
            run -= part
        for _ in range(run):
            symbols[n] = value
            n += 1
    return symbols[:n], extras[:n]
