// The cell as the program makes it, number by number: thrown pores and the greedy graph of `sample.mirrored_faces`,
// `sample.dart_throwing` and `connect.mbdst` with one face color, and the level that `tune.porosity` finds. Names are
// those of method/sampling, method/connecting and method/porosity, where the reasons stand.
class Refused extends Error {
  constructor(key, message, hint) { super(message); Object.assign(this, { key, hint }); }
}

// SHA-256 (FIPS 180-4) of ASCII text as eight words; the browser's own is not there for files that are opened.
function sha256(text) {
  const primes = [], root = (x, k) => Math.floor((x ** (1 / k) % 1) * 2 ** 32) | 0;
  for (let n = 2; primes.length < 64; n++) if (primes.every((p) => n % p)) primes.push(n);
  const state = primes.slice(0, 8).map((p) => root(p, 2)), keys = primes.map((p) => root(p, 3));
  const bytes = [...text].map((c) => c.charCodeAt(0)), bits = 8 * bytes.length, turn = (x, n) => (x >>> n) | (x << (32 - n));
  bytes.push(128);
  while (bytes.length % 64 !== 56) bytes.push(0);
  for (let i = 7; i >= 0; i--) bytes.push(Math.floor(bits / 256 ** i) & 255);
  for (let at = 0; at < bytes.length; at += 64) {
    const w = [];
    for (let i = 0; i < 64; i++) {
      if (i < 16) w.push((bytes[at + 4 * i] << 24) | (bytes[at + 4 * i + 1] << 16) | (bytes[at + 4 * i + 2] << 8) | bytes[at + 4 * i + 3]);
      else {
        const x = w[i - 15], y = w[i - 2];
        w.push((w[i - 16] + (turn(x, 7) ^ turn(x, 18) ^ (x >>> 3)) + w[i - 7] + (turn(y, 17) ^ turn(y, 19) ^ (y >>> 10))) | 0);
      }
    }
    let [a, b, c, d, e, f, g, h] = state;
    for (let i = 0; i < 64; i++) {
      const t1 = (h + (turn(e, 6) ^ turn(e, 11) ^ turn(e, 25)) + ((e & f) ^ (~e & g)) + keys[i] + w[i]) | 0;
      const t2 = ((turn(a, 2) ^ turn(a, 13) ^ turn(a, 22)) + ((a & b) ^ (a & c) ^ (b & c))) | 0;
      [h, g, f, e, d, c, b, a] = [g, f, e, (d + t1) | 0, c, b, a, (t1 + t2) | 0];
    }
    [a, b, c, d, e, f, g, h].forEach((v, i) => { state[i] = (state[i] + v) | 0; });
  }
  return state.map((v) => v >>> 0);
}

// The generator of one draw (engine/run/context.py): NumPy's SeedSequence and PCG64 (O'Neill 2014).
function generator(seed, path, key) {
  const words = [String(seed), String(path.length), ...path, ...key.map(String)];
  const swapped = (v) => ((v >>> 24) | ((v >>> 8) & 0xff00) | ((v << 8) & 0xff0000) | (v << 24)) >>> 0;
  const entropy = sha256(words.map((word) => `${word.length}:${word}`).join("")).map(swapped);
  while (entropy.length > 1 && entropy[entropy.length - 1] === 0) entropy.pop();
  let hash = 0x43b0d7e5;
  const hashed = (value) => {
    value ^= hash;
    hash = Math.imul(hash, 0x931e8875);
    value = Math.imul(value, hash);
    return value ^ (value >>> 16);
  };
  const mixed = (x, y) => { const v = (Math.imul(0xca01f9dd, x) - Math.imul(0x4973f715, y)) | 0; return v ^ (v >>> 16); };
  const pool = [0, 1, 2, 3].map((i) => hashed(entropy[i] ?? 0));
  for (let s = 0; s < 4; s++) for (let d = 0; d < 4; d++) if (s !== d) pool[d] = mixed(pool[d], hashed(pool[s]));
  for (let s = 4; s < entropy.length; s++) for (let d = 0; d < 4; d++) pool[d] = mixed(pool[d], hashed(entropy[s]));
  hash = 0x8b51f9dd;
  const made = [0, 1, 2, 3, 0, 1, 2, 3].map((i) => {
    let value = pool[i] ^ hash;
    hash = Math.imul(hash, 0x58f38ded);
    value = Math.imul(value, hash);
    return BigInt((value ^ (value >>> 16)) >>> 0);
  });
  const [a, b, c, d] = [0, 2, 4, 6].map((i) => made[i] | (made[i + 1] << 64n >> 32n));
  const all = (1n << 128n) - 1n, increment = ((((c << 64n) | d) << 1n) | 1n) & all;
  let state = 0n;
  const step = () => { state = (state * 0x2360ED051FC65DA44385DF649FCCF645n + increment) & all; };
  step();
  state = (state + ((a << 64n) | b)) & all;
  step();
  const word = () => {
    step();
    const value = ((state >> 64n) ^ state) & 0xffffffffffffffffn, n = state >> 122n;
    return ((value >> n) | (value << (64n - n))) & 0xffffffffffffffffn;
  };
  const random = () => Number(word() >> 11n) * 2 ** -53;
  // half a word at a time, of which bits are taken until they are small enough, as NumPy's shuffle does
  let half = null;
  const bits = (count) => {
    const both = half ?? word();
    half = half === null ? both >> 32n : null;
    return Number(BigInt.asUintN(count, both));
  };
  const permutation = (n) => {
    const order = Array.from({ length: n }, (_, i) => i);
    for (let i = n - 1; i > 0; i--) {
      let j = i + 1;
      while (j > i) j = bits(32 - Math.clz32(i));
      [order[i], order[j]] = [order[j], order[i]];
    }
    return order;
  };
  return { word, random, permutation };
}

// SplitMix64 from one word of state (sampling/cell_list.py).
function streamOf(start) {
  let state = start;
  const kept = (v) => BigInt.asUintN(64, v);
  return () => {
    state = kept(state + 0x9E3779B97F4A7C15n);
    let word = kept((state ^ (state >> 30n)) * 0xBF58476D1CE4E5B9n);
    word = kept((word ^ (word >> 27n)) * 0x94D049BB133111EBn);
    return Number((word ^ (word >> 31n)) >> 11n) * 2 ** -53;
  };
}

// Mean number of pores of a saturated box (sampling/capacity.py).
function capacityOf(sides, spacing, periodic) {
  if (spacing > 1 && periodic) return 0;
  const factors = sides.map((side) => (periodic ? Math.min(side + 0.64 * spacing, 1) : side + 0.64 * spacing) / spacing);
  let best = 1;
  for (let used = 0; used < 1 << sides.length; used++) {
    const chosen = factors.filter((_, i) => (used >> i) & 1 && sides[i] > 0);
    best = Math.max(best, [1, 0.7476, 0.6966, 0.7336][chosen.length] * chosen.reduce((a, b) => a * b, 1));
  }
  return best;
}

function fits(count, sides, spacing, periodic, what) {
  const capacity = capacityOf(sides, spacing, periodic);
  if (count > capacity && count > Math.ceil(capacity)) {
    throw new Refused("", `${count} pores do not fit into the ${what}, which holds about ${capacity.toFixed(1)}`, "give fewer pores, or a smaller share");
  }
  return capacity;
}

// Pores that keep `spacing` to each other, in a period of 1 along all axes or none.
class Darts {
  constructor(spacing, periodic) {
    Object.assign(this, { reach: spacing + 1e-14, period: periodic ? 1 : Infinity, points: [] });
  }

  gap(a, b) {
    const gap = Math.abs(a - b);
    return Math.min(gap, Math.abs(this.period - gap));
  }

  isFree(p) {
    const reach2 = this.reach * this.reach;
    for (const q of this.points) {
      const dx = this.gap(q[0], p[0]), dy = this.gap(q[1], p[1]), dz = this.gap(q[2], p[2]);
      if (dx * dx + dy * dy + dz * dz < reach2) return false;
    }
    return true;
  }

  // A dart into the box of these corner and edges; true if it is kept.
  dart(next, corner, edge, low, side) {
    const p = corner.map((c, a) => (edge[a] > 0 ? c + edge[a] * next() : c));
    if (p.some((v, a) => side[a] > 0 && v >= low[a] + side[a]) || !this.isFree(p)) return false;
    this.points.push(p);
    return true;
  }

  throw(next, low, side, wanted, budget) {
    let placed = 0;
    for (let n = 0; n < budget && placed < wanted; n++) if (this.dart(next, low, side, low, side)) placed++;
    return placed;
  }

  // Darts into voxels that no single pore covers, which are halved until none is left (sampling/active_voxels.py).
  fill(next, low, side, wanted) {
    const coarsest = this.reach / Math.sqrt(Math.max(1, side.filter((s) => s > 0).length)), reach2 = this.reach * this.reach;
    const roots = side.map((s) => (s > 0 ? Math.max(1, Math.ceil(s / coarsest)) : 1));
    const edge = side.map((s, a) => (s > 0 ? s / roots[a] : 0)), parts = side.map((s) => (s > 0 ? 2 : 1));
    let finest = Math.min(...edge.filter((e) => e > 0)), placed = 0;
    const open = (place) => !this.points.some((q) => {
      const far = q.map((v, a) => this.gap(v, low[a] + place[a] * edge[a] + edge[a] / 2) + edge[a] / 2);
      return far[0] * far[0] + far[1] * far[1] + far[2] * far[2] < reach2;
    });
    const split = (place, counts) => {
      const found = [];
      for (let c = 0; c < counts[2]; c++) for (let b = 0; b < counts[1]; b++) for (let a = 0; a < counts[0]; a++) {
        const own = [place[0] * counts[0] + a, place[1] * counts[1] + b, place[2] * counts[2] + c];
        if (open(own)) found.push(own);
      }
      return found;
    };
    let voxels = split([0, 0, 0], roots);
    while (placed < wanted && voxels.length && finest > 1e-9 * this.reach) {
      const { length } = voxels;
      for (let n = 0; n < length; n++) {
        const place = voxels[Math.min(Math.floor(next() * length), length - 1)];
        if (this.dart(next, low.map((v, a) => v + place[a] * edge[a]), edge, low, side) && ++placed === wanted) return placed;
      }
      for (let a = 0; a < 3; a++) edge[a] /= 2;
      finest /= 2;
      voxels = voxels.flatMap((place) => split(place, parts));
    }
    return placed;
  }
}

// Pores on faces, and on edges and corners (sampling/edges.py), of a cell with so many pores.
function homogeneousCounts(total, spacing) {
  const number = intervalsOf(spacing), sites = 3 * number - 2;
  const inside = Math.min(Math.max(3 * 0.69 * total * spacing * Math.max(0, 1 - 1.5 * spacing) ** 2, 3), total / 2);
  return { inside, share: Math.min(1.031 * Math.sqrt(total * spacing ** 3), 1, total / 4 / sites) };
}

function intervalsOf(spacing) {
  const most = Math.floor(1 / spacing + 1e-9), least = Math.ceil(1 / (Math.sqrt(3) * spacing) - 1e-9);
  return Math.max(1, Math.min(most, Math.max(least, Math.round(1 / (1.5 * spacing)))));
}

// Spacing at which so many pores are this share of the packing limit.
function spacingOf(total, share) {
  const within = (l) => 0.95 * capacityOf([1, 1, 1], l, true);
  let low = 1e-2, high = 0.5;
  if (total < share * within(high)) {
    throw new Refused("", `${total} pores at a packing share of ${share} would need a spacing above half a cell`, "give more pores, or a larger share");
  }
  for (let n = 0; n < 60; n++) {
    const middle = (low + high) / 2;
    if (share * within(middle) > total) low = middle;
    else high = middle;
  }
  return { total: share * within(low), spacing: low };
}

function edgeSites(rng, spacing) {
  const number = intervalsOf(spacing), spare = 1 - number * spacing;
  const widest = Math.max(Math.sqrt(3) * spacing, 1 / number + 1e-9);
  for (let tried = 0; tried < 1000; tried++) {
    const cuts = Array.from({ length: number - 1 }, () => rng.random()).sort((a, b) => a - b);
    const ends = [0, ...cuts, 1], widths = cuts.map((_, i) => i).concat(number - 1).map((i) => spacing + spare * (ends[i + 1] - ends[i]));
    if (Math.max(...widths) <= widest || number === 1) return placesOf(widths);
  }
  const widths = Array(number).fill(1 / number), middle = Math.floor(number / 2);
  for (let sweep = 0; sweep < 50; sweep++) {
    const order = rng.permutation(number);
    for (let p = 0; p < middle; p++) {
      const i = order[p], j = order[middle + p], both = widths[i] + widths[j];
      const low = Math.max(spacing, both - widest), high = Math.min(widest, both - spacing);
      widths[i] = low + (high - low) * rng.random();
      widths[j] = both - widths[i];
    }
  }
  return placesOf(widths);
}

function placesOf(widths) {
  const places = [0];
  for (let i = 0, sum = 0; i < widths.length - 1; i++) places.push((sum += widths[i]));
  return places;
}

// The patterns of the three faces, with the pores of the edges that they own.
function mirroredFaces(rng, asked, share) {
  const { total, spacing } = spacingOf(asked, share), counts = homogeneousCounts(total, spacing), sites = [];
  for (let axis = 0; axis < 3; axis++) {
    sites.push(edgeSites(rng, spacing).slice(axis === 0 ? 0 : 1).map((v) => {
      const p = [0, 0, 0];
      p[(axis + 2) % 3] = v;
      return p;
    }));
  }
  const chosen = sites.map((places) => {
    const start = rng.random();
    return places.filter((_, i) => Math.floor((i + 1) * counts.share + start) > Math.floor(i * counts.share + start));
  });
  const wanted = Math.max(0, roundHalfEven(counts.inside)), rows = [0, 1, 2].map((axis) => Math.floor(wanted / 3) + (axis < wanted % 3 ? 1 : 0));
  const next = streamOf(rng.word());
  for (let throws = 0, best = 0; throws < 20 && (!throws || wanted - best <= 1.5 * Math.sqrt(wanted)); throws++) {
    const darts = new Darts(spacing, true), found = [[], [], []];
    darts.points.push(...sites.flat());
    const placed = inTurn(darts, next, rows, found);
    if (placed === wanted) return { spacing, patterns: found.map((own, axis) => [...chosen[axis], ...own]) };
    best = Math.max(best, placed);
  }
  throw new Refused("", `no more pores fit onto the faces: ${wanted} are asked for`, "give fewer pores, or a smaller share");
}

// Pore by pore, in an order that is drawn afresh in each round (sampling/faces.py).
function inTurn(darts, next, wanted, found) {
  const order = [0, 1, 2], full = [false, false, false];
  let thrown = true, placed = 0;
  while (thrown) {
    thrown = false;
    for (let last = 2; last > 0; last--) {
      const other = Math.min(Math.floor(next() * (last + 1)), last);
      [order[last], order[other]] = [order[other], order[last]];
    }
    for (const axis of order) {
      if (full[axis] || found[axis].length === wanted[axis]) continue;
      const side = [1, 1, 1];
      side[axis] = 0;
      const got = darts.throw(next, [0, 0, 0], side, 1, 150) || darts.fill(next, [0, 0, 0], side, 1);
      if (got) found[axis].push(darts.points[darts.points.length - 1]);
      else full[axis] = true;
      placed += got;
      thrown = true;
    }
  }
  return placed;
}

const roundHalfEven = (v) => { const f = Math.floor(v), d = v - f; return d > 0.5 || (d === 0.5 && f % 2) ? f + 1 : f; };

// Pores of the interior, clear of those on the faces around.
function interior(rng, total, patterns, spacing) {
  const low = Array(3).fill(spacing / 2), high = 1 - spacing / 2, side = low.map((v) => high - v), around = [];
  const count = Math.max(total - patterns.flat().length, 0), capacity = fits(count, side, spacing, false, "interior");
  patterns.forEach((pattern, axis) => {
    for (const p of pattern) for (let s = 0; s < 27; s++) {
      const shift = [Math.floor(s / 9) - 1, (Math.floor(s / 3) % 3) - 1, (s % 3) - 1];
      const image = p.map((v, a) => v + shift[a]);
      if (shift[axis] >= 0 && image.every((v, a) => v >= low[a] - spacing - 1e-9 && v <= low[a] + side[a] + spacing + 1e-9)) around.push(image);
    }
  });
  if (!count) return [];
  const next = streamOf(rng.word()), naive = Math.floor(Math.min(count, 0.75 * capacity));
  for (let throws = 0, best = 0; throws < 20; throws++) {
    const darts = new Darts(spacing, false);
    darts.points.push(...around);
    let placed = darts.throw(next, low, side, naive, 60 * naive + 1000);
    if (placed < count) placed += darts.fill(next, low, side, count - placed);
    if (placed === count) return darts.points.slice(around.length);
    best = Math.max(best, placed);
    if (count - best > 1.5 * Math.sqrt(count)) break;
  }
  throw new Refused("", `no more pores fit into the interior: ${count} are asked for`, "give fewer pores, or a smaller share");
}

const squared = (p, q) => { let d = 0; for (let a = 0; a < 3; a++) { const s = q[a] - p[a]; d += s * s; } return d; };

// Each pore and its k nearest, joined to one piece by the shortest bridges (connecting/candidates.py); sorted pairs.
function candidates(points, k) {
  const n = points.length, keys = new Set();
  points.forEach((p, i) => {
    const near = points.map((q, j) => [squared(p, q), j]).filter(([, j]) => j !== i).sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    for (const [, j] of near.slice(0, k)) keys.add(Math.min(i, j) * n + Math.max(i, j));
  });
  const edges = () => [...keys].sort((a, b) => a - b).map((key) => [Math.floor(key / n), key % n]);
  const own = edges(), labels = labelsOf(n, own), first = bridges(points, labels, () => false);
  if (!first.length) return own;
  const used = new Set(first.flat()), free = new Set(labels.filter((_, i) => !used.has(i)));
  const second = bridges(points, labels, (i) => used.has(i) && free.has(labels[i]));
  for (const [i, j] of [...first, ...second]) keys.add(i * n + j);
  return edges();
}

function labelsOf(n, edges) {
  const parent = Array.from({ length: n }, (_, i) => i);
  for (const [i, j] of edges) { const a = rootOf(parent, i), b = rootOf(parent, j); parent[Math.max(a, b)] = Math.min(a, b); }
  const roots = parent.map((_, i) => rootOf(parent, i)), places = [...new Set(roots)];
  return roots.map((root) => places.indexOf(root));
}

function rootOf(parent, i) {
  while (parent[i] !== i) i = parent[i] = parent[parent[i]];
  return i;
}

function bridges(points, labels, skipped) {
  const found = [];
  for (labels = [...labels]; new Set(labels).size > 1;) {
    const sizes = [];
    for (const label of labels) sizes[label] = (sizes[label] ?? 0) + 1;
    const largest = sizes.indexOf(Math.max(...sizes)), made = [];
    sizes.forEach((_, part) => {
      if (part === largest) return;
      let best = Infinity, ends = null;
      points.forEach((p, i) => {
        if (labels[i] !== part || skipped(i)) return;
        points.forEach((q, j) => {
          if (labels[j] === part || skipped(j)) return;
          const d = squared(p, q), pair = [Math.min(i, j), Math.max(i, j)];
          if (d < best || (d === best && (pair[0] - ends[0] || pair[1] - ends[1]) < 0)) { best = d; ends = pair; }
        });
      });
      made.push(ends);
    });
    found.push(...made);
    const merged = labelsOf(sizes.length, made.map(([i, j]) => [labels[i], labels[j]]));
    labels = labels.map((label) => merged[label]);
  }
  return found;
}

// A subgraph that is being chosen from candidate edges, and the moves on it (connecting/moves.py, exchange.py).
class Subgraph {
  constructor(points, edges, lower, upper) {
    const n = points.length, length = edges.map(([i, j]) => Math.sqrt(squared(points[i], points[j])));
    const order = edges.map((_, e) => e).sort((a, b) => length[a] - length[b] || a - b);
    const lists = () => Array.from({ length: n }, () => []);
    Object.assign(this, { n, edges, length, order, lower, upper, near: lists(), at: lists(), chosen: edges.map(() => false), seen: new Int32Array(n), stamp: 0 });
    for (const e of order) for (const v of edges[e]) this.near[v].push(e);
  }

  other(e, v) { return this.edges[e][0] + this.edges[e][1] - v; }
  low(v) { return this.at[v].length < this.lower; }
  room(v) { return this.at[v].length < this.upper; }
  spare(v) { return this.at[v].length > this.lower; }

  insert(e) {
    this.chosen[e] = true;
    for (const v of this.edges[e]) this.at[v].push(e);
  }

  remove(e) {
    this.chosen[e] = false;
    for (const v of this.edges[e]) {
      const own = this.at[v], place = own.indexOf(e), last = own.pop();
      if (last !== e) own[place] = last;
    }
  }

  move(outs, ins) {
    for (const e of outs) if (e >= 0) this.remove(e);
    for (const e of ins) if (e >= 0) this.insert(e);
  }

  // Whether a path leads from start to goal once the move is made.
  joined(start, goal, out1, out2, in1, in2) {
    const stamp = ++this.stamp, queue = [start];
    this.seen[start] = stamp;
    for (let head = 0; head < queue.length; head++) {
      const v = queue[head], own = this.at[v];
      for (let s = 0; s < own.length + 2; s++) {
        const e = s < own.length ? own[s] : s === own.length ? in1 : in2;
        if (s < own.length ? e === out1 || e === out2 : e < 0 || (this.edges[e][0] !== v && this.edges[e][1] !== v)) continue;
        const w = this.other(e, v);
        if (w === goal) return true;
        if (this.seen[w] !== stamp) { this.seen[w] = stamp; queue.push(w); }
      }
    }
    return false;
  }

  allowed(out1, out2, in1, in2) {
    return [out1, out2].every((e) => e < 0 || this.joined(...this.edges[e], out1, out2, in1, in2));
  }

  // A tree with bounded degrees, then edges up to the lower bounds; false if the candidates are too few.
  connectAndFill() {
    const parent = Array.from({ length: this.n }, (_, i) => i);
    let parts = this.n;
    for (const e of this.order) {
      const [u, v] = this.edges[e];
      if (!this.room(u) || !this.room(v)) continue;
      const a = rootOf(parent, u), b = rootOf(parent, v);
      if (a !== b) { this.insert(e); parent[Math.max(a, b)] = Math.min(a, b); parts--; }
    }
    for (const e of this.order) {
      const [u, v] = this.edges[e];
      if (!this.chosen[e] && this.low(u) && this.low(v)) this.insert(e);
    }
    if (parts !== 1) return false;
    let left = 0;
    for (let u = 0; u < this.n; u++) while (this.low(u)) if (!this.raise(u)) { left++; break; }
    return left === 0;
  }

  // One more edge at u along the cheapest trail: in; in, out; or in, out, in.
  raise(u) {
    const { length } = this;
    let best = Infinity, move = null;
    for (const e1 of this.near[u]) {
      if (this.chosen[e1]) continue;
      const t1 = this.other(e1, u);
      for (let r = -1; r < this.at[t1].length; r++) {
        const e2 = r >= 0 ? this.at[t1][r] : -1, t2 = r >= 0 ? this.other(e2, t1) : t1;
        const cost = length[e1] - (r >= 0 ? length[e2] : 0);
        if (t2 === u) continue;
        for (let q = -1; q < (r >= 0 ? this.near[t2].length : 0); q++) {
          let e3 = -1, total = cost, well = r >= 0 ? this.spare(t2) : this.room(t1);
          if (q >= 0) {
            e3 = this.near[t2][q];
            total = cost + length[e3];
            const t3 = this.other(e3, t2);
            well = this.at[t3].length + (t3 === u ? 1 : 0) < this.upper && e3 !== e1 && !this.chosen[e3];
            if (total >= best) break;
          }
          if (!well || total >= best) continue;
          if (e2 < 0 || this.joined(...this.edges[e2], e2, -1, e1, e3)) { best = total; move = [[e2], [e1, e3]]; }
        }
      }
    }
    if (move) this.move(...move);
    return move !== null;
  }

  improve() {
    const waiting = Array(this.n).fill(true);
    for (let left = this.n, v = 0; left > 0;) {
      if (waiting[v]) {
        const move = this.shorter(v);
        if (move) {
          this.move(...move);
          for (const e of move.flat()) for (const w of e >= 0 ? this.edges[e] : []) { left += waiting[w] ? 0 : 1; waiting[w] = true; }
          continue;
        }
        waiting[v] = false;
        left--;
      }
      v = v + 1 < this.n ? v + 1 : 0;
    }
  }

  // The first shortening trail out, in, out, in, or a beginning of it, from t0.
  shorter(t0) {
    const { length, near, at } = this, tiny = 1e-12, spare = this.spare(t0);
    for (const e1 of at[t0]) {
      const t1 = this.other(e1, t0);
      if (spare && this.spare(t1) && this.allowed(e1, -1, -1, -1)) return [[e1], []];
      for (const e2 of near[t1]) {
        const gain2 = length[e1] - length[e2];
        if (gain2 <= tiny) break;
        if (this.chosen[e2]) continue;
        const t2 = this.other(e2, t1);
        if ((t2 === t0 || (spare && this.room(t2))) && this.allowed(e1, -1, e2, -1)) return [[e1], [e2]];
        if (t2 === t0) continue;
        for (const e3 of at[t2]) {
          const t3 = this.other(e3, t2), gain3 = gain2 + length[e3];
          if (e3 === e1 || t3 === t1) continue;
          if (spare && at[t3].length - (t3 === t0 ? 1 : 0) > this.lower && this.allowed(e1, e3, e2, -1)) return [[e1, e3], [e2]];
          for (const e4 of near[t3]) {
            if (gain3 - length[e4] <= tiny) break;
            if (this.chosen[e4] || e4 === e2) continue;
            const t4 = this.other(e4, t3);
            if ((t4 === t0 || (spare && this.room(t4))) && this.allowed(e1, e3, e2, e4)) return [[e1, e3], [e2, e4]];
          }
        }
      }
    }
    return null;
  }
}

// Harary's graph along a walk round the shortest tree: it meets any bounds (connecting/greedy.py).
function ringGraph(points, degree) {
  const n = points.length, best = Array(n).fill(Infinity), parent = Array(n).fill(0), outside = Array(n).fill(true), tree = [];
  for (let m = 1, last = 0; m < n; m++) {
    outside[last] = false;
    let nearest = -1;
    for (let j = 0; j < n; j++) {
      if (!outside[j]) continue;
      const d = squared(points[last], points[j]);
      if (d < best[j] || (d === best[j] && last < parent[j])) { best[j] = d; parent[j] = last; }
      if (nearest < 0 || best[j] < best[nearest]) nearest = j;
    }
    tree.push([Math.min(parent[nearest], nearest), Math.max(parent[nearest], nearest)]);
    last = nearest;
  }
  const around = Array.from({ length: n }, () => []), ring = [], stack = [0], seen = new Set();
  for (const [i, j] of tree.sort((a, b) => a[0] - b[0] || a[1] - b[1])) { around[i].push(j); around[j].push(i); }
  while (stack.length) {
    const v = stack.pop();
    if (seen.has(v)) continue;
    seen.add(v);
    ring.push(v);
    stack.push(...around[v].filter((w) => !seen.has(w)).reverse());
  }
  const pairs = [], rest = degree % (n - 1), add = (i, j) => { const [a, b] = [ring[i % n], ring[j % n]]; pairs.push([Math.min(a, b), Math.max(a, b)]); };
  if (degree >= n - 1) for (let i = 0; i < n; i++) for (let j = i + 1; j < n; j++) add(i, j);
  for (let step = 1; step <= Math.floor(rest / 2); step++) for (let i = 0; i < n; i++) add(i, i + step);
  if (rest % 2) for (let i = 0; i < Math.floor(n / 2) + (n % 2); i++) add(i, i + Math.floor(n / 2));
  return pairs.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
}

// The greedy subgraph of one piece: pairs i < j.
function greedySubgraph(points, lower, upper) {
  const n = points.length;
  if (n < 2) return [];
  if (lower > n - 1) throw new Refused("degree", `${n} pores can't have ${lower} tunnels each: a pore has at most ${n - 1}`, "lower the bound, or place more pores");
  if (upper < (n > 2 ? 2 : 1)) throw new Refused("degree", `${n} pores can't be connected with at most ${upper} tunnels each`, "raise the upper bound");
  if (lower === upper && (n * lower) % 2) throw new Refused("degree", `${n} pores can't have exactly ${lower} tunnels each`, "raise the upper bound");
  lower = Math.max(lower, 1);
  for (let k = Math.min(10, n - 1); ; k = Math.min(2 * k, n - 1)) {
    let graph = new Subgraph(points, candidates(points, k), lower, upper);
    if (!graph.connectAndFill()) {
      if (k < Math.min(n - 1, 40)) continue;
      const ring = ringGraph(points, n > 2 ? Math.max(lower, 2) : lower), keys = new Set([...graph.edges, ...ring].map(([i, j]) => i * n + j));
      graph = new Subgraph(points, [...keys].sort((a, b) => a - b).map((key) => [Math.floor(key / n), key % n]), lower, upper);
      const place = new Map(graph.edges.map(([i, j], e) => [i * n + j, e]));
      for (const [i, j] of ring) graph.insert(place.get(i * n + j));
    }
    graph.improve();
    return graph.edges.filter((_, e) => graph.chosen[e]);
  }
}

// Pores, and tunnels between them as [i, j, shift]: faces and interior apart, then each face pore to the nearest pore
// of the interior on both sides. Pores of the faces come first, axis by axis.
function graphOf({ seed, pores, share, degree }) {
  const path = (stage) => ["tune.porosity", "cell@0", stage];
  const { patterns, spacing } = mirroredFaces(generator(seed, path("sample.mirrored_faces"), []), pores, share);
  const inside = interior(generator(seed, path("sample.dart_throwing"), [0]), pores, patterns, spacing);
  const centers = [...patterns.flat(), ...inside], first = patterns.flat().length, edges = [];
  const join = (points, start, lower, upper) => {
    for (const [i, j] of greedySubgraph(points, lower, upper)) edges.push([i + start, j + start, [0, 0, 0]]);
  };
  join(inside, first, ...degree);
  let start = 0;
  patterns.forEach((pattern, axis) => {
    const n = pattern.length, low = Math.min(degree[0], Math.max(n - 1, 0));
    join(pattern, start, low, low === degree[1] && (n * low) % 2 ? degree[1] + 1 : degree[1]);
    for (let side = 0; side < 2 && inside.length; side++) {
      const shift = [0, 1, 2].map((a) => (a === axis ? side : 0));
      pattern.forEach((p, i) => {
        const moved = p.map((v, a) => v + shift[a]), far = inside.map((q) => squared(q, moved));
        edges.push([first + far.indexOf(Math.min(...far)), start + i, shift]);
      });
    }
    start += n;
  });
  return { centers, edges, spacing };
}

// The kernels of a cell for the live view: omega and mu from the radii at a level, as `field.gaussian` does.
const CUTOFF = 1e-5, LAW = { power: 1, cutoff: CUTOFF };

function kernelsOf({ centers, edges }, { pore_radius, tunnel_radius, level }) {
  const log = Math.log(1 / level), omega = log / pore_radius ** 2, mu = log / tunnel_radius;
  return {
    omega, mu,
    arrays: {
      pores: new Float32Array(centers.flatMap((p) => [...p, omega])),
      tunnels: new Float32Array(edges.flatMap(([i, j, shift]) => [...centers[i], ...centers[j].map((v, a) => v + shift[a]), mu])),
    },
  };
}

// Sums at n^3 points that lie off the planes of symmetry, as `tune.porosity` measures.
function sumsOff({ arrays: { pores, tunnels } }, n) {
  const sums = new Float32Array(n ** 3), shift = [0.309, 0.7236, 0.1459].map((share) => (0.5 - share) / n);
  addKernels(sums, [n, n, n], n, true, LAW, pores, tunnels, shift);
  return sums;
}

function shareFrom(sums, level) {
  let count = 0;
  for (let i = 0; i < sums.length; i++) if (sums[i] >= level) count++;
  return count / sums.length;
}

// The level at which a share of the samples is void, by bisection.
function levelFor(sums, target) {
  const wanted = Math.max(1, Math.min(sums.length - 1, Math.round(target * sums.length))) / sums.length;
  let low = 0, high = sums.reduce((a, b) => Math.max(a, b), 0);
  for (let n = 0; n < 60; n++) {
    const middle = (low + high) / 2, share = shareFrom(sums, middle);
    if (share === wanted) return middle;
    if (share > wanted) low = middle;
    else high = middle;
  }
  if (low <= 0) {
    throw new Refused("target", `a porosity of ${target} lies beyond the reach of every kernel; positive levels reach up to ${shareFrom(sums, 1e-30).toPrecision(4)}`, "give more pores, or larger ones");
  }
  return (low + high) / 2;
}

// The level of a target, on the program's grids of n samples and more, and the porosity on the finer one of them; the
// page may react between them.
async function tuned(kernels, target, n) {
  for (let tried = 0; tried < 3; tried++) {
    const level = levelFor(sumsOff(kernels, n), target);
    n += Math.floor(n / 2) + 1;
    await new Promise((done) => setTimeout(done));
    const porosity = shareFrom(sumsOff(kernels, n), level);
    if (Math.abs(porosity - target) <= 0.001) return { level, porosity };
  }
  throw new Refused("target", `the porosity ${target} is missed by more than 0.001 on the program's grids`, "give a target nearer to those of other cells");
}
