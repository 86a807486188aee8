// Shows triangles, with the camera, the light and the passes of the other views. What is seen of a closed mesh from
// within lies behind the plane that cuts it open, where the ray has entered the solid: it is drawn as this cut. An open
// mesh has no inside, and shows its back in the color of a cut.
const CORNER = `#version 300 es
precision highp float;
layout(location = 0) in vec3 place;
layout(location = 1) in vec3 way;
layout(location = 2) in vec3 still;
layout(location = 3) in vec3 wayStill;
uniform float share;  // of what the vertices move
uniform vec3 box, right, up, toward;
uniform vec2 middle, pixels, jitter;
uniform float pixel, depth;
out vec3 at, smooth_;
invariant gl_Position;
void main() {
  at = mix(still, place, share);
  smooth_ = mix(wayStill, way, share);
  vec2 s = (vec2(dot(right, at), dot(up, at)) - middle) / pixel - jitter;
  gl_Position = vec4(2.0 * s / pixels, -dot(toward, at - 0.5 * box) / depth, 1.0);
}`;

const TRIANGLE = `#version 300 es
precision highp float;
in vec3 at, smooth_;
uniform vec3 high, cut;  // the normal of the plane that cuts a closed mesh open; zero if there is none
${LIGHT}
out vec4 color;
void main() {
  if (any(greaterThan(at, high))) discard;
  vec3 flat_ = normalize(cross(dFdx(at), dFdy(at)));
  // an edge stays sharp: there the mean of its sides is the direction of none of them
  vec3 normal = dot(flat_, smooth_) > 0.85 * length(smooth_) ? normalize(smooth_) : flat_;
  vec3 back = cut == vec3(0.0) ? flat_ : cut;
  color = vec4(lit(gl_FrontFacing ? BONE : CUT, gl_FrontFacing ? normal : back, 0.9), 1.0);
}`;

class MeshView extends View {
  constructor(canvas) {
    super(canvas);
    this.triangles = this.program(TRIANGLE, CORNER);
    this.depth = this.gl.createRenderbuffer();
    this.share = 1;
  }

  // Vertices as x..., y..., z... in steps of 1/65535 of the longest edge; corners of triangles likewise; and where the
  // vertices were before they moved, if they did.
  loadMesh(vertices, faces, size, closed, still) {
    const gl = this.gl, n = vertices.length / 3, m = faces.length / 3, longest = Math.max(...size) || 1, corners = new Uint32Array(3 * m);
    for (let t = 0; t < m; t++) corners.set([faces[t], faces[m + t], faces[2 * m + t]], 3 * t);
    const shape = (numbers) => {
      const places = new Float32Array(3 * n);
      for (let i = 0; i < n; i++) for (let a = 0; a < 3; a++) places[3 * i + a] = numbers[a * n + i] / 65535;
      return [places, directions(places, corners)];
    };
    const moved = shape(vertices);
    Object.assign(this, { size: size.map((s) => s / longest), count: 3 * m, places: moved[0], closed, domain: false, periodic: false });
    [...moved, ...(still ? shape(still) : moved)].forEach((data, index) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(index);
      gl.vertexAttribPointer(index, 3, gl.FLOAT, false, 0, 0);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
  }

  points() {
    return Array.from({ length: this.places.length / 3 }, (_, i) => this.places.subarray(3 * i, 3 * i + 3));
  }

  // First the depths, then the colors of what is in front: passes are added up, so that nothing may be drawn over.
  pass(w, h) {
    const gl = this.gl, u = this.triangles.at;
    if (this.deep !== this.held) {
      this.deep = this.held;
      gl.bindRenderbuffer(gl.RENDERBUFFER, this.depth);
      gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, this.canvas.width, this.canvas.height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, this.depth);
    }
    const { high } = this.aim(this.triangles, w, h);
    gl.uniform3fv(u("box"), this.size);
    gl.uniform1f(u("share"), this.share);
    gl.uniform3fv(u("high"), high.map((v, a) => (a === this.cut.axis && this.cut.at < 1 ? v : v + 1)));
    gl.uniform3fv(u("cut"), high.map((_, a) => (this.closed && a === this.cut.axis && this.cut.at < 1 ? 1 : 0)));
    gl.uniform1f(u("depth"), Math.hypot(...this.size));
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    for (const shown of [false, true]) {
      gl.colorMask(shown, shown, shown, shown);
      gl.depthFunc(shown ? gl.EQUAL : gl.LESS);
      gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
    }
    gl.disable(gl.DEPTH_TEST);
  }
}

// The mean direction of the triangles about each vertex.
function directions(places, corners) {
  const ways = new Float32Array(places.length);
  for (let t = 0; t < corners.length; t += 3) {
    const [p, q, r] = corners.subarray(t, t + 3);
    const u = [0, 1, 2].map((a) => places[3 * q + a] - places[3 * p + a]), v = [0, 1, 2].map((a) => places[3 * r + a] - places[3 * p + a]);
    const way = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const c of [p, q, r]) for (let a = 0; a < 3; a++) ways[3 * c + a] += way[a];
  }
  for (let i = 0; i < ways.length; i += 3) {
    const length = Math.hypot(ways[i], ways[i + 1], ways[i + 2]) || 1;
    for (let a = 0; a < 3; a++) ways[i + a] /= length;
  }
  return ways;
}
