// Shows a field by rays in WebGL 2: quick and coarse while something moves, then finer by the mean of jittered passes.
class View {
  // Raises an error where there is no WebGL 2.
  constructor(canvas) {
    this.canvas = canvas;
    const gl = (this.gl = canvas.getContext("webgl2", { alpha: true, antialias: false, preserveDrawingBuffer: true }));
    if (!gl) throw new Error("no WebGL 2");
    this.float = Boolean(gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float"));
    this.rays = this.program(RAYS);
    this.shown = this.program(SHOWN);
    this.field = gl.createTexture();
    this.bricks = gl.createTexture();
    this.sum = gl.createTexture();
    this.target = gl.createFramebuffer();
    this.camera = new Camera();
    this.repeat = 1;
    this.cut = { axis: 2, at: 1 }; // share of the box that is kept
    this.level = 0.5;
    this.most = 12;
    this.finest = 1;
    this.coarse = 0.5;
    this.timer = 0;
    this.onframe = () => {};
  }

  program(text, corners = CORNERS) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, corners], [gl.FRAGMENT_SHADER, text]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) || "no shader");
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "no program");
    const places = {};
    return { program, at: (name) => (places[name] ??= gl.getUniformLocation(program, name)) };
  }

  // Bytes of field and domain (or null), x fastest; `size` is that of the box in any unit.
  load(field, domain, shape, size, periodic) {
    const gl = this.gl, [nx, ny, nz] = shape, pairs = new Uint8Array(2 * field.length);
    for (let i = 0; i < field.length; i++) {
      pairs[2 * i] = field[i];
      pairs[2 * i + 1] = domain ? domain[i] : 0;
    }
    Object.assign(this, { shape, size, periodic, domain: Boolean(domain), texel: size[0] / nx });
    const wrap = periodic ? gl.REPEAT : gl.CLAMP_TO_EDGE;
    this.texture3d(this.field, 0, pairs, shape, gl.LINEAR, wrap);
    const { least, count } = leastOfBricks(field, domain, shape, periodic);
    this.texture3d(this.bricks, 1, least, count, gl.NEAREST, gl.CLAMP_TO_EDGE);
    this.least = least;
    this.count = count;
    this.steepest = steepest(field, shape) / 255 / this.texel;
  }

  texture3d(texture, unit, bytes, [nx, ny, nz], filter, wrap) {
    const gl = this.gl;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_3D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.RG8, nx, ny, nz, 0, gl.RG, gl.UNSIGNED_BYTE, bytes);
    gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MAG_FILTER, filter);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(gl.TEXTURE_3D, side, wrap);
  }

  // What the camera has to show: corners of the box, or of the bricks that hold something of a part.
  points() {
    const [sx, sy, sz] = this.size.map((s) => s * this.repeat), points = [];
    if (!this.domain) {
      for (let i = 0; i < 8; i++) points.push([(i & 1) * sx, ((i >> 1) & 1) * sy, (i >> 2) * sz]);
      return points;
    }
    const [bx, by, bz] = this.count, edge = 8 * this.texel;
    for (let k = 0, b = 0; k < bz; k++) for (let j = 0; j < by; j++) for (let i = 0; i < bx; i++, b++) {
      if (this.least[2 * b + 1] < 128) for (let c = 0; c < 8; c++) {
        points.push([Math.min(sx, (i + (c & 1)) * edge), Math.min(sy, (j + ((c >> 1) & 1)) * edge), Math.min(sz, (k + (c >> 2)) * edge)]);
      }
    }
    return points.length ? points : [[0, 0, 0], [sx, sy, sz]];
  }

  // Point the camera at it.
  fit() {
    const points = this.points();
    const { middle, span } = extent(this.camera.axes(), points);
    this.middle = middle;
    this.span = span;
    const center = [0, 1, 2].map((a) => {
      let low = Infinity, high = -Infinity;
      for (const p of points) { low = Math.min(low, p[a]); high = Math.max(high, p[a]); }
      return (low + high) / 2;
    });
    const axes = this.camera.axes();
    this.center = center;
    this.off = [middle[0] - dot(axes[0], center), middle[1] - dot(axes[1], center)];
  }

  changed() {
    this.passes = 0;
    clearTimeout(this.timer);
    if (!this.waiting) {
      this.waiting = true;
      requestAnimationFrame(() => {
        this.waiting = false;
        this.frame(this.moved ? Math.min(this.coarse, this.finest) : this.finest);
        this.moved = true;
        this.timer = setTimeout(() => this.refine(), 160);
      });
    }
  }

  refine() {
    if (this.scale !== this.finest) this.passes = 0;
    this.frame(this.finest);
    this.moved = true;
    if (this.passes < this.most) this.timer = setTimeout(() => this.refine(), 10);
  }

  frame(scale) {
    const gl = this.gl, { width, height } = this.canvas, started = performance.now();
    if (gl.isContextLost()) return;
    const w = Math.max(1, Math.round(width * scale)), h = Math.max(1, Math.round(height * scale));
    this.scale = scale;
    if (this.held !== `${width} ${height}`) {
      this.held = `${width} ${height}`;
      gl.activeTexture(gl.TEXTURE2);
      gl.bindTexture(gl.TEXTURE_2D, this.sum);
      const inside = this.float ? gl.RGBA16F : gl.RGBA8;
      gl.texImage2D(gl.TEXTURE_2D, 0, inside, width, height, 0, gl.RGBA, this.float ? gl.HALF_FLOAT : gl.UNSIGNED_BYTE, null);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.sum, 0);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(0, 0, w, h);
    if (this.passes === 0 || !this.float) {
      this.passes = 0;
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT);
    }
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    this.pass(w, h);
    this.passes++;
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.useProgram(this.shown.program);
    gl.uniform1i(this.shown.at("sum"), 2);
    gl.uniform1f(this.shown.at("passes"), this.passes);
    gl.uniform2f(this.shown.at("pixels"), w, h);
    gl.uniform2f(this.shown.at("of"), width, height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits for the picture
    this.timed(performance.now() - started, scale);
  }

  // Where a point of the box is seen, as shares of the picture from its upper left, and whether that is the far side.
  screen(p) {
    const { width: w, height: h } = this.canvas, axes = this.camera.axes();
    const pixel = Math.max(this.span[0] / (0.92 * w), this.span[1] / (0.92 * h)) / this.camera.zoom;
    const [x, y] = [0, 1].map((a) => dot(axes[a], p) - dot(axes[a], this.center) - this.off[a] - this.camera.shift[a] * h * pixel);
    return [0.5 + x / pixel / w, 0.5 - y / pixel / h, dot(axes[2], p) < dot(axes[2], this.center)];
  }

  // What all programs are told of the camera; each pass looks elsewhere in the pixel (a Halton sequence).
  aim({ program, at: u }, w, h) {
    const gl = this.gl, axes = this.camera.axes();
    const halton = (n, base) => { let f = 1, r = 0; for (; n; n = Math.floor(n / base)) { f /= base; r += f * (n % base); } return r; };
    const room = 0.92, pixel = Math.max(this.span[0] / (room * w), this.span[1] / (room * h)) / this.camera.zoom;
    const high = this.size.map((s) => s * this.repeat);
    high[this.cut.axis] *= this.cut.at;
    gl.useProgram(program);
    ["right", "up", "toward"].forEach((name, a) => gl.uniform3fv(u(name), axes[a]));
    const shift = this.camera.shift.map((s) => s * h * pixel);
    gl.uniform2f(u("middle"), dot(axes[0], this.center) + this.off[0] + shift[0], dot(axes[1], this.center) + this.off[1] + shift[1]);
    gl.uniform2f(u("pixels"), w, h);
    const first = this.passes === 0;
    gl.uniform2f(u("jitter"), first ? 0 : halton(this.passes, 2) - 0.5, first ? 0 : halton(this.passes, 3) - 0.5);
    gl.uniform1f(u("pixel"), pixel);
    return { high };
  }

  // One sample for each pixel.
  pass(w, h) {
    const gl = this.gl, u = this.rays.at, { high } = this.aim(this.rays, w, h);
    gl.uniform1i(u("field"), 0);
    gl.uniform1i(u("bricks"), 1);
    gl.uniform3fv(u("size"), this.size);
    gl.uniform3fv(u("low"), [0, 0, 0]);
    gl.uniform3fv(u("high"), high);
    gl.uniform1f(u("level"), this.level);
    gl.uniform1f(u("texel"), this.texel);
    gl.uniform2f(u("reach"), 1 / Math.max(this.steepest, 1e-9), 2 * this.texel);
    gl.uniform1i(u("domain"), this.domain ? 1 : 0);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // Slow machines get fewer and coarser passes; while something moves, as many pixels as a twelfth of a second allows.
  timed(ms, scale) {
    if (!this.judged && ms > 400) Object.assign(this, { finest: 0.6, most: 3 });
    this.judged = true;
    const fits = scale * Math.sqrt(80 / Math.max(ms, 1));
    this.coarse = Math.max(0.15, Math.min(1, 0.5 * this.coarse + 0.5 * fits));
    this.onframe(ms);
  }
}

// The least of field and domain in bricks of 8^3 samples and the samples around each.
function leastOfBricks(field, domain, [nx, ny, nz], periodic) {
  const count = [nx, ny, nz].map((n) => Math.ceil(n / 8)), least = new Uint8Array(2 * count[0] * count[1] * count[2]).fill(255);
  if (!domain) for (let b = 1; b < least.length; b += 2) least[b] = 0;
  // along each axis, the bricks that a sample belongs to, one or two
  const bricks = [nx, ny, nz].map((n, a) => Array.from({ length: n }, (_, i) => {
    const own = [i >> 3];
    const add = (b) => { if (periodic) b = ((b % count[a]) + count[a]) % count[a]; if (b >= 0 && b < count[a] && !own.includes(b)) own.push(b); };
    if (i % 8 === 0) add((i >> 3) - 1);
    if (i % 8 === 7 || i === n - 1) add((i >> 3) + 1);
    return own;
  }));
  for (let k = 0, s = 0; k < nz; k++) for (let j = 0; j < ny; j++) {
    const rows = [];
    for (const c of bricks[2][k]) for (const b of bricks[1][j]) rows.push((c * count[1] + b) * count[0]);
    for (let i = 0; i < nx; i++, s++) for (const row of rows) for (const a of bricks[0][i]) {
      const at = 2 * (row + a);
      if (field[s] < least[at]) least[at] = field[s];
      if (domain && domain[s] < least[at + 1]) least[at + 1] = domain[s];
    }
  }
  return { least, count };
}

// The steepest slope between neighbors, in bytes a sample.
function steepest(field, [nx, ny, nz]) {
  let most = 1;
  for (let k = 0; k < nz - 1; k++) for (let j = 0; j < ny - 1; j++) {
    for (let i = 0, s = (k * ny + j) * nx; i < nx - 1; i++, s++) {
      const dx = field[s + 1] - field[s], dy = field[s + nx] - field[s], dz = field[s + nx * ny] - field[s];
      most = Math.max(most, dx * dx + dy * dy + dz * dz);
    }
  }
  return Math.sqrt(most);
}
