"""Deflate for the rows of a binary image, straight from its bits: literals and runs of one byte, one code a picture.

Layers are nearly flat, and the *Up* filter of PNG leaves zeros wherever a row equals the one above. So whole words are
skipped by one comparison, and from one byte that is not zero to the next is one step: some zeros and the byte after
them are one token, whatever they are written as. The filtered picture is never written, and the check sum follows from
the tokens. Several times as fast as zlib with run lengths only, in files as large, and their bytes depend on the
picture alone, not on the zlib that Python was built with.

Formats: RFC 1950 (zlib) and RFC 1951 (deflate), P. Deutsch, 1996; PNG, third edition (W3C, 2025), for the filter.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import I32, I64, U8, U16, U64
from sppm_pipeline.services.bit_rows import bit_index
from sppm_pipeline.services.jit.compiled import inline_jit, jit

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


_FILTER_UP = 2
_LONGEST_RUN, _SHORTEST_RUN = 258, 3
_END = 256  # symbol of the end of a block
_SYMBOLS = 286
_MODULUS = 65521  # of the check sum
# Tokens: a byte after up to seven zeros is 256 zeros + byte; then up to 259 zeros; then the byte before, so many times
_CLOSE = 8
_ZEROS = 256 * _CLOSE
_AGAIN = _ZEROS + _LONGEST_RUN + 2
_TOKENS = _AGAIN + _LONGEST_RUN + 1
_MAX_BITS = 32  # of a token that is written at once

_ONE, _EIGHT, _BYTE = np.uint64(1), np.uint64(8), np.uint64(0xFF)
_COPIES = np.uint64(0x0101010101010101)
_TOPS, _BELOW = np.uint64(0x8080808080808080), np.uint64(0x7F7F7F7F7F7F7F7F)


def _run_symbols() -> tuple[I32, I32, I32]:
    """Symbol, number of extra bits and their value for a run of each length (RFC 1951, section 3.2.5)."""
    symbol, bits, value = (np.zeros(_LONGEST_RUN + 1, np.int32) for _ in range(3))
    length, code = _SHORTEST_RUN, 257
    for extra in [0] * 8 + [n for n in range(1, 6) for _ in range(4)]:
        for k in range(1 << extra):
            if length + k < _LONGEST_RUN:
                symbol[length + k], bits[length + k], value[length + k] = code, extra, k
        length, code = length + (1 << extra), code + 1
    symbol[_LONGEST_RUN] = 285
    return symbol, bits, value


_RUN_SYMBOL, _RUN_BITS, _RUN_VALUE = _run_symbols()
# in which order the lengths of the codes of lengths are written (RFC 1951, section 3.2.7)
_ORDER = np.array([16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15], np.int32)


def deflated_rows(rows: U64, width: int) -> U8:
    """A zlib stream of a picture with one bit a pixel, each row after the Up filter of PNG.

    The rows (h, words), from the top, are bits as in `services.bit_rows`.
    """
    tokens, counts, check = _tokens(rows, -(-width // 8))
    lengths = code_lengths(_symbol_counts(counts), LONGEST_CODE)
    used = max(257, int(np.flatnonzero(lengths)[-1]) + 1)
    # one code of distances, of one bit, is for the byte before
    symbols, extras = lengths_packed(np.append(lengths[:used], np.int32(1)))
    short = code_lengths(np.bincount(symbols, minlength=19), LONGEST_OF_LENGTHS)
    return _written(tokens, counts, check, lengths, used, short, symbols, extras)


@inline_jit
def _png_order(word: np.uint64) -> np.uint64:
    """The bits of each byte in turn: in PNG the first pixel is the highest bit, in a word of a row the lowest."""
    word = ((word >> _ONE) & np.uint64(0x5555555555555555)) | ((word & np.uint64(0x5555555555555555)) << _ONE)
    two, four = np.uint64(2), np.uint64(4)
    word = ((word >> two) & np.uint64(0x3333333333333333)) | ((word & np.uint64(0x3333333333333333)) << two)
    return ((word >> four) & np.uint64(0x0F0F0F0F0F0F0F0F)) | ((word & np.uint64(0x0F0F0F0F0F0F0F0F)) << four)


@jit
def _tokens(rows: U64, row_bytes: int) -> tuple[U16, I32, int]:
    """The tokens of a picture, how often each occurs, and the check sum of its filtered bytes.

    Places count the filtered bytes from the first; `at` is the one of the last byte that a token describes. That byte
    is `last`, and `again` times it follows.
    """
    height, words = rows.shape
    out = np.empty(max(1024, rows.size), np.uint16)
    counts = np.zeros(_TOKENS, np.int32)
    filtered = np.zeros(words, np.uint64)
    above = np.zeros(words, np.uint64)
    most = 2 * row_bytes + 16  # tokens that one row can add, and the end
    n, at, last, again = 0, int(np.int64(-1)), int(np.int64(0)), int(np.int64(0))
    low, high = int(np.int64(1)), int(np.int64(0))  # the halves of Adler's check sum
    for y in range(height):
        if n + most > out.size:
            grown = np.empty(2 * out.size + most, np.uint16)
            for i in range(n):  # an array assigned to a slice costs seconds of compilation
                grown[i] = out[i]
            out = grown
        row = rows[y]
        for w in range(words):
            turned = _png_order(row[w])
            over = above[w]
            above[w] = turned
            # bytes less bytes: the top bits are kept out of the way of what is borrowed, and put right afterwards
            filtered[w] = ((turned | _TOPS) - (over & _BELOW)) ^ ((turned ^ ~over) & _TOPS)
        begin = int(np.int64(y)) * (row_bytes + 1)
        for w in range(-1, words):
            if w < 0:
                word, place = np.uint64(_FILTER_UP), begin
            else:
                word, place = filtered[w], begin + 1 + 8 * w
                if word == 0:
                    continue
                first = int(np.int64(word & _BYTE))
                # eight bytes alike, as where a flat side of the part begins
                if word == np.uint64(first) * _COPIES and row_bytes >= 8 * w + 8:
                    if last != first or at + 1 != place:
                        n = _repeat(out, n, counts, last, again)
                        zeros = place - at - 1
                        n = _zeros(out, n, counts, zeros)
                        n = _repeat(out, n, counts, first, 1)
                        high += zeros * low
                        at, last, again = place - 1, first, -1
                    again += 8
                    at += 8
                    high += 8 * low + 36 * first
                    low += 8 * first
                    continue
            if again > 0:
                n = _repeat(out, n, counts, last, again)
                again = 0
            there = (((word & _BELOW) + _BELOW) | word) & _TOPS
            while there != 0:
                lowest = there & (~there + _ONE)
                bit = int(np.int64(bit_index(lowest)))
                there ^= lowest
                last = int(np.int64((word >> np.uint64(bit - 7)) & _BYTE))
                zeros = place + (bit >> 3) - at - 1
                at += zeros + 1
                high += (zeros + 1) * low + last
                low += last
                if zeros >= _CLOSE:
                    n = _zeros(out, n, counts, zeros)
                    zeros = 0
                token = zeros * 256 + last
                out[n] = token
                counts[token] += 1
                n += 1
        low %= _MODULUS
        high %= _MODULUS
    if again > 0:
        n = _repeat(out, n, counts, last, again)
    zeros = int(np.int64(height)) * (row_bytes + 1) - 1 - at
    high = (high + zeros * low) % _MODULUS
    n = _zeros(out, n, counts, zeros)
    return out[:n], counts, high << 16 | low


@jit
def _repeat(out: U16, n: int, counts: I32, value: int, times: int) -> int:
    """Append the byte before, so many times."""
    while times >= _SHORTEST_RUN:
        length = min(times, _LONGEST_RUN)
        out[n] = _AGAIN + length
        counts[_AGAIN + length] += 1
        n += 1
        times -= length
    for _ in range(times):
        out[n] = value
        counts[value] += 1
        n += 1
    return n


@jit
def _zeros(out: U16, n: int, counts: I32, zeros: int) -> int:
    """Append zeros after another byte."""
    if zeros == 0:
        return n
    length = min(zeros, _LONGEST_RUN + 1)
    out[n] = _ZEROS + length
    counts[_ZEROS + length] += 1
    return _repeat(out, n + 1, counts, 0, zeros - length)


@jit
def _members(token: int, symbols: I64) -> int:
    """Write down what a token is written as, and return how many: bytes, and 256 + length for a run."""
    if token >= _AGAIN:
        symbols[0] = 256 + token - _AGAIN
        return 1
    zeros = token - _ZEROS if token >= _ZEROS else token // 256
    n = 0
    if zeros > _SHORTEST_RUN:
        symbols[0] = 0
        symbols[1] = 256 + zeros - 1
        n = 2
    else:
        for _ in range(zeros):
            symbols[n] = 0
            n += 1
    if token < _ZEROS:
        symbols[n] = token % 256
        n += 1
    return n


@jit
def _symbol_counts(counts: I32) -> I64:
    """Counts of each symbol of bytes and runs, from the counts of tokens."""
    often = np.zeros(_SYMBOLS, np.int64)
    often[_END] = 1
    members = np.zeros(4, np.int64)
    for token in range(_TOKENS):
        if counts[token] > 0:
            for i in range(_members(token, members)):
                symbol = members[i] if members[i] < 256 else np.int64(_RUN_SYMBOL[members[i] - 256])
                often[symbol] += counts[token]
    return often


@jit
def _written(
    tokens: U16, counts: I32, check: int, lengths: I32, used: int, short: I32, symbols: I32, extras: I32
) -> U8:
    """The stream: header, one block with codes of its own, check sum.

    `lengths` are those of the codes of symbols, of which the first `used` are written as `symbols` with `extras`, whose
    codes have the lengths `short`.
    """
    members = np.zeros(4, np.int64)
    n_symbols = symbols.size
    codes = prefix_codes(lengths)
    short_codes = prefix_codes(short)
    listed = 19
    while listed > 4 and short[_ORDER[listed - 1]] == 0:
        listed -= 1
    # what bytes and runs are written as: code, extra bits of the length, code of the distance
    bits = np.zeros(256 + _LONGEST_RUN + 1, np.uint64)
    size = np.zeros(256 + _LONGEST_RUN + 1, np.uint64)
    for i in range(256):
        bits[i], size[i] = codes[i], lengths[i]
    for i in range(_SHORTEST_RUN, _LONGEST_RUN + 1):
        symbol = _RUN_SYMBOL[i]
        bits[256 + i] = codes[symbol] | np.uint64(_RUN_VALUE[i]) << np.uint64(lengths[symbol])
        size[256 + i] = lengths[symbol] + _RUN_BITS[i] + 1
    # and tokens
    token_bits = np.zeros(_TOKENS, np.uint64)
    token_size = np.zeros(_TOKENS, np.uint8)
    room = 0
    for token in range(_TOKENS):
        if counts[token] > 0:
            total = np.uint64(0)
            for i in range(_members(token, members)):
                if total + size[members[i]] <= np.uint64(_MAX_BITS):
                    token_bits[token] |= bits[members[i]] << total
                total += size[members[i]]
            token_size[token] = total
            room += int(np.int64(counts[token])) * int(np.int64(total))
    out = np.empty(room // 8 + 1024, np.uint8)
    out[0], out[1] = 0x78, 0x01  # deflate with a window of 32 kB, the fastest level
    n = 2
    held, filled = np.uint64(0), np.uint64(0)
    value = np.zeros(40 + 2 * n_symbols, np.uint64)
    width = np.zeros(40 + 2 * n_symbols, np.uint64)
    value[0], width[0] = 0b101, 3  # the last block, with codes of its own
    value[1], width[1] = used - 257, 5
    value[2], width[2] = 0, 5
    value[3], width[3] = listed - 4, 4
    heads = 4
    for i in range(listed):
        value[heads], width[heads] = short[_ORDER[i]], 3
        heads += 1
    for i in range(n_symbols):
        symbol = symbols[i]
        value[heads], width[heads] = short_codes[symbol], short[symbol]
        value[heads + 1] = extras[i]
        width[heads + 1] = 2 if symbol == 16 else 3 if symbol == 17 else 7 if symbol == 18 else 0
        heads += 2
    for i in range(heads):
        held |= value[i] << filled
        filled += width[i]
        while filled >= _EIGHT:
            out[n] = held & _BYTE
            n += 1
            held >>= _EIGHT
            filled -= _EIGHT
    for token in tokens:
        parts = _members(int(np.int64(token)), members) if token_size[token] > _MAX_BITS else 1
        for part in range(parts):
            if parts == 1:
                held |= token_bits[token] << filled
                filled += np.uint64(token_size[token])
            else:
                held |= bits[members[part]] << filled
                filled += size[members[part]]
            if filled >= np.uint64(32):
                out[n] = held & _BYTE
                out[n + 1] = held >> np.uint64(8) & _BYTE
                out[n + 2] = held >> np.uint64(16) & _BYTE
                out[n + 3] = held >> np.uint64(24) & _BYTE
                n += 4
                held >>= np.uint64(32)
                filled -= np.uint64(32)
    held |= codes[_END] << filled
    filled += np.uint64(lengths[_END])
    while filled > np.uint64(0):
        out[n] = held & _BYTE
        n += 1
        held >>= _EIGHT
        filled -= min(filled, _EIGHT)
    for shift in (24, 16, 8, 0):
        out[n] = check >> shift & 255
        n += 1
    return out[:n]
