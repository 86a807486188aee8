// Add kernels to a box of n samples a cell edge, x fastest: pores exp(-omega r^2), tunnels exp(-mu d^power) of the
// distance d from a segment. Sample 0 lies half a sample inside of the box's corner. A periodic box is one cell.
// Radii are multiplied by `pore` and `tunnel`; `shift` is the corner of the kernels' cell in the box.
function addKernels(sums, [nx, ny, nz], n, periodic, law, pores, tunnels, shift = [0, 0, 0], pore = 1, tunnel = 1) {
  const depth = Math.log(1 / law.cutoff), shape = [nx, ny, nz];
  const distance = law.power === 2 ? (d2) => d2 : law.power === 1 ? Math.sqrt : (d2) => d2 ** (law.power / 2);
  const at = (i, a) => (periodic ? ((i % shape[a]) + shape[a]) % shape[a] : i);
  const span = (low, high, a) => {
    const first = Math.ceil(low * n - 0.5), last = Math.floor(high * n - 0.5);
    return periodic ? [first, last] : [Math.max(0, first), Math.min(shape[a] - 1, last)];
  };

  function profile(center, omega, [first, last]) {
    const values = [];
    for (let i = first; i <= last; i++) values.push(Math.exp(-omega * ((i + 0.5) / n - center) ** 2));
    return values;
  }

  // the places along x, once for all rows of a kernel: remainders take longer than all else
  const columns = ([first, last]) => Int32Array.from({ length: Math.max(0, last - first + 1) }, (_, i) => at(i + first, 0));

  for (let p = 0; p < pores.length; p += 4) {
    const omega = pores[p + 3] / (pore * pore), reach = Math.sqrt(depth / omega);
    const center = [0, 1, 2].map((a) => pores[p + a] + shift[a]);
    const spans = center.map((c, a) => span(c - reach, c + reach, a));
    const [ex, ey, ez] = center.map((c, a) => profile(c, omega, spans[a])), column = columns(spans[0]);
    for (let k = 0; k < ez.length; k++) {
      const z = at(k + spans[2][0], 2) * ny;
      for (let j = 0; j < ey.length; j++) {
        const row = (z + at(j + spans[1][0], 1)) * nx, part = ez[k] * ey[j];
        if (part < law.cutoff) continue;
        for (let i = 0; i < ex.length; i++) sums[row + column[i]] += part * ex[i];
      }
    }
  }

  for (let s = 0; s < tunnels.length; s += 7) {
    const ends = [0, 1, 2, 3, 4, 5].map((c) => tunnels[s + c] + shift[c % 3]), [ax, ay, az, bx, by, bz] = ends;
    const mu = tunnels[s + 6] / tunnel ** law.power, reach = (depth / mu) ** (1 / law.power), reach2 = reach * reach;
    const [[x0, x1], [y0, y1], [z0, z1]] = [0, 1, 2].map((a) =>
      span(Math.min(ends[a], ends[a + 3]) - reach, Math.max(ends[a], ends[a + 3]) + reach, a));
    const dx = bx - ax, dy = by - ay, dz = bz - az, length2 = dx * dx + dy * dy + dz * dz || 1;
    const column = columns([x0, x1]);
    for (let k = z0; k <= z1; k++) {
      const pz = (k + 0.5) / n - az;
      for (let j = y0; j <= y1; j++) {
        const py = (j + 0.5) / n - ay, row = (at(k, 2) * ny + at(j, 1)) * nx;
        for (let i = x0; i <= x1; i++) {
          const px = (i + 0.5) / n - ax;
          const t = Math.max(0, Math.min(1, (px * dx + py * dy + pz * dz) / length2));
          const ox = px - t * dx, oy = py - t * dy, oz = pz - t * dz, d2 = ox * ox + oy * oy + oz * oz;
          if (d2 < reach2) sums[row + column[i - x0]] += Math.exp(-mu * distance(d2));
        }
      }
    }
  }
}

// The sum of the kernels of a periodic cell at the centers of n^3 voxels.
function sumKernels(law, pores, tunnels, n, pore = 1, tunnel = 1) {
  const sums = new Float32Array(n * n * n);
  addKernels(sums, [n, n, n], n, true, law, pores, tunnels, [0, 0, 0], pore, tunnel);
  return sums;
}

// The sum of all kernels in m^3 cells of a tiling from cell `low` on, n samples a cell edge: pieces are interiors, faces
// by axis and color, and connectors by their codes; every face belongs to the cell on its high side.
function sumCells(lattice, arrays, low, m, n) {
  const sums = new Float32Array((m * n) ** 3), NONE = 255, { shape, interiors, colors } = lattice;
  const connectors = new Map(lattice.codes.map((code, q) => [code, interiors + 3 * colors + q]));
  const stored = (numbers, size, place) => {
    const own = place.map((v, a) => (lattice.periodic ? ((v % shape[a]) + shape[a]) % shape[a] : v + lattice.halo));
    return own.every((v, a) => v >= 0 && v < size[a]) ? numbers[(own[0] * size[1] + own[1]) * size[2] + own[2]] : NONE;
  };
  const add = (piece, shift) => {
    if (piece === undefined) return;
    const own = (array, first, width) => array.subarray(width * first[piece], width * first[piece + 1]);
    addKernels(sums, [m * n, m * n, m * n], n, false, lattice, own(arrays.pores, lattice.first_pore, 4),
      own(arrays.tunnels, lattice.first_tunnel, 7), shift);
  };
  for (let i = -1; i <= m; i++) for (let j = -1; j <= m; j++) for (let k = -1; k <= m; k++) {
    const shift = [i, j, k], place = shift.map((v, a) => v + low[a]), interior = stored(arrays.interior, shape, place);
    if (interior !== NONE) add(interior, shift);
    for (let axis = 0; axis < 3; axis++) {
      const size = shape.map((s, a) => s + (a === axis ? 1 : 0)), faces = arrays[`faces${axis}`];
      const lower = stored(faces, size, place), upper = stored(faces, size, place.map((v, a) => v + (a === axis ? 1 : 0)));
      if (lower !== NONE) add(interiors + axis * colors + lower, shift);
      if (interior === NONE) continue;
      [lower, upper].forEach((color, side) => {
        if (color !== NONE) add(connectors.get(((interior * 3 + axis) * 2 + side) * colors + color), shift);
      });
    }
  }
  return sums;
}

// Sums as the bytes of a sampled field: 255 at `top`.
function sumBytes(sums, top) {
  const bytes = new Uint8Array(sums.length);
  for (let i = 0; i < sums.length; i++) bytes[i] = Math.round(255 * Math.min(1, sums[i] / top));
  return bytes;
}
