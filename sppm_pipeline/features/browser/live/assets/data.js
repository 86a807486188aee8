// View files: a line of JSON and packed arrays; see live/data.py.
function headOf(bytes) {
  const first = bytes.indexOf(10) + 1, end = bytes.indexOf(10, first);
  return { head: JSON.parse(new TextDecoder().decode(bytes.subarray(first, end))), end };
}

async function readView(bytes) {
  const { head, end } = headOf(bytes), arrays = {};
  let place = end + 1;
  for (const blob of head.blobs) {
    const plain = await unpacked(bytes.subarray(place, place + blob.bytes));
    place += blob.bytes;
    const kinds = { u8: Uint8Array, u16: Uint16Array, u32: Uint32Array, f32: Float32Array };
    const numbers = (arrays[blob.name] = new kinds[blob.type](plain.buffer, plain.byteOffset, blob.count));
    if (blob.delta) for (let i = 1; i < numbers.length; i++) numbers[i] += numbers[i - 1];
  }
  return { head, arrays };
}

// The share of the part that is void at a level (0..1 of a byte), from a histogram of the bytes inside of the part.
// A sample at the border of the part counts by how much of it lies inside.
class Porosity {
  constructor(field, domain) {
    this.below = new Float64Array(257);
    for (let i = 0; i < field.length; i++) {
      this.below[field[i] + 1] += domain ? Math.max(0, Math.min(1, 1.5 - (2 * domain[i]) / 255)) : 1;
    }
    for (let i = 0; i < 256; i++) this.below[i + 1] += this.below[i];
  }

  at(level) {
    // byte b stands for values from b - 1/2 to b + 1/2
    const place = Math.max(0, Math.min(256, 255 * level + 0.5)), i = Math.min(255, Math.floor(place));
    const solid = this.below[i] + (place - i) * (this.below[i + 1] - this.below[i]);
    return this.below[256] ? 1 - solid / this.below[256] : 0;
  }
}
