// The sum of the kernels of a periodic cell at the centers of n^3 voxels, x fastest: pores exp(-omega r^2), tunnels
// exp(-mu d^power) of the distance d from a segment. Radii are multiplied by `pore` and `tunnel`.
function sumKernels(head, pores, tunnels, n, pore = 1, tunnel = 1) {
  const sums = new Float32Array(n * n * n), depth = Math.log(1 / head.cutoff);
  const wrapped = (i) => ((i % n) + n) % n;
  const span = (low, high) => [Math.ceil(low * n - 0.5), Math.floor(high * n - 0.5)];

  function profile(center, omega, [first, last]) {
    const values = [];
    for (let i = first; i <= last; i++) values.push(Math.exp(-omega * ((i + 0.5) / n - center) ** 2));
    return values;
  }

  for (let p = 0; p < pores.length; p += 4) {
    const omega = pores[p + 3] / (pore * pore), reach = Math.sqrt(depth / omega);
    const spans = [0, 1, 2].map((a) => span(pores[p + a] - reach, pores[p + a] + reach));
    const [ex, ey, ez] = [0, 1, 2].map((a) => profile(pores[p + a], omega, spans[a]));
    for (let k = 0; k < ez.length; k++) {
      const z = wrapped(k + spans[2][0]) * n * n;
      for (let j = 0; j < ey.length; j++) {
        const row = z + wrapped(j + spans[1][0]) * n, part = ez[k] * ey[j];
        if (part < head.cutoff) continue;
        for (let i = 0; i < ex.length; i++) sums[row + wrapped(i + spans[0][0])] += part * ex[i];
      }
    }
  }

  for (let s = 0; s < tunnels.length; s += 7) {
    const [ax, ay, az, bx, by, bz, own] = tunnels.subarray(s, s + 7);
    const mu = own / tunnel ** head.power, reach = (depth / mu) ** (1 / head.power), reach2 = reach * reach;
    const [x0, x1] = span(Math.min(ax, bx) - reach, Math.max(ax, bx) + reach);
    const [y0, y1] = span(Math.min(ay, by) - reach, Math.max(ay, by) + reach);
    const [z0, z1] = span(Math.min(az, bz) - reach, Math.max(az, bz) + reach);
    const dx = bx - ax, dy = by - ay, dz = bz - az, length2 = dx * dx + dy * dy + dz * dz || 1;
    for (let k = z0; k <= z1; k++) {
      const pz = (k + 0.5) / n - az;
      for (let j = y0; j <= y1; j++) {
        const py = (j + 0.5) / n - ay, row = (wrapped(k) * n + wrapped(j)) * n;
        for (let i = x0; i <= x1; i++) {
          const px = (i + 0.5) / n - ax;
          const t = Math.max(0, Math.min(1, (px * dx + py * dy + pz * dz) / length2));
          const d2 = (px - t * dx) ** 2 + (py - t * dy) ** 2 + (pz - t * dz) ** 2;
          if (d2 < reach2) sums[row + wrapped(i)] += Math.exp(-mu * (head.power === 2 ? d2 : Math.sqrt(d2)));
        }
      }
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
