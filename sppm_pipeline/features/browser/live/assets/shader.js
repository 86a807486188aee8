// Rays through a level set of samples. Solid is where the field is below the level and the domain's distance below its
// middle. `field` holds both; `bricks` the least of both in 8^3 samples, so that rays jump where nothing can be.
const CORNERS = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID % 2, gl_VertexID / 2) * 4.0 - 1.0, 0.0, 1.0); }`;

// A color under the three lights of render/shading.py, which stand with the viewer; `open_` is how much of the sky is.
const LIGHT = `
uniform vec3 right, up, toward;
const vec3 BONE = vec3(0.761, 0.672, 0.527), CUT = vec3(0.658, 0.202, 0.098), OWN = vec3(0.604, 0.552, 0.456);
vec3 lit(vec3 color, vec3 normal, float open_) {
  vec3 n = vec3(dot(normal, right), dot(normal, up), dot(normal, toward));
  float key = max(dot(n, vec3(-0.4603, 0.6554, 0.5989)), 0.0), fill = max(dot(n, vec3(0.8111, 0.1217, 0.5721)), 0.0);
  float shine = pow(max(dot(n, vec3(-0.2574, 0.3665, 0.8941)), 0.0), 32.0), sky = 0.5 + 0.5 * n.y;
  float direct = 0.25 * open_ + 0.75 * open_ * open_;
  float warm = 0.82 * key * direct, cool = 0.36 * fill * direct, round_ = (0.17 + 0.22 * sky) * open_;
  vec3 light = vec3(warm * 1.03 + cool * 0.90, warm + cool, warm * 0.95 + cool * 1.12) + round_;
  return color * light + 0.05 * shine * direct;
}`;

const RAYS = `#version 300 es
precision highp float;
precision highp sampler3D;
uniform sampler3D field, bricks;
uniform vec3 size, low, high;       // of one copy; corners of what is shown
uniform vec2 middle, pixels, jitter;
uniform float pixel, level, texel;  // sizes of a pixel and of a sample
uniform vec2 reach;                 // least distance for a unit of field and of domain
uniform bool domain;
out vec4 color;

${LIGHT}

vec2 both(vec3 p) {
  vec2 s = texture(field, p / size).rg;
  return vec2((s.r - level) * reach.x, domain ? (s.g - 0.5) * reach.y : -1e9);
}

float solid(vec3 p) { vec2 s = both(p); return max(s.x, s.y); }

float along(vec3 p, vec3 e, bool outer) {
  vec2 d = both(p + e) - both(p - e);
  return outer ? d.y : d.x;
}

void main() {
  vec2 place = (gl_FragCoord.xy + jitter - 0.5 * pixels) * pixel + middle;
  vec3 d = -toward, o = right * place.x + up * place.y;
  vec3 inv = 1.0 / (d + vec3(equal(d, vec3(0.0))) * 1e-9);
  vec3 a = (low - o) * inv, b = (high - o) * inv, first = min(a, b), last = max(a, b);
  float t = max(max(first.x, first.y), first.z), end = min(min(last.x, last.y), last.z);
  color = vec4(0.0);
  if (t >= end) return;
  float start = t, before = t, brick = 8.0 * texel;
  bool hit = false, cap = false;
  ivec3 count = textureSize(bricks, 0);
  for (int i = 0; i < 700; i++) {
    vec3 p = o + d * t, cell = floor(p / brick + d * 1e-4);
    ivec3 at = ivec3(mod(cell, vec3(count)));
    vec2 least = texelFetch(bricks, clamp(at, ivec3(0), count - 1), 0).rg;
    if (least.r >= level || (domain && least.g >= 0.5)) {
      vec3 leave = ((cell + step(0.0, d)) * brick - o) * inv;
      before = t;
      t = max(min(min(leave.x, leave.y), leave.z), t) + 0.02 * texel;
      if (t >= end) break;
      continue;
    }
    float f = solid(p);
    if (f < 0.0) { hit = true; cap = t == start; break; }
    if (t >= end) break;
    before = t;
    t = min(t + max(f, 0.2 * texel), end);
  }
  if (!hit) return;
  vec3 normal;
  bool outer = false;
  if (cap) {
    normal = -sign(d) * vec3(first.x >= start, first.y >= start, first.z >= start);
  } else {
    for (int i = 0; i < 7; i++) {
      float half_ = 0.5 * (before + t);
      if (solid(o + d * half_) < 0.0) t = half_; else before = half_;
    }
    vec3 p = o + d * t;
    vec2 s = both(p);
    outer = s.y > s.x;
    float e = outer ? texel : 0.7 * texel;
    normal = vec3(along(p, vec3(e, 0, 0), outer), along(p, vec3(0, e, 0), outer), along(p, vec3(0, 0, e), outer));
  }
  normal = normalize(normal + vec3(1e-9));
  vec3 p = o + d * t;
  // how much of the sky is open: seven short cones about the normal
  vec3 side = normalize(abs(normal.z) < 0.9 ? cross(normal, vec3(0, 0, 1)) : cross(normal, vec3(1, 0, 0)));
  vec3 other = cross(normal, side);
  float hidden = 0.0;
  for (int i = 0; i < 7; i++) {
    float turn = 1.0472 * float(i);
    vec3 way = i == 6 ? normal : normalize(0.55 * normal + 0.83 * (cos(turn) * side + sin(turn) * other));
    for (int k = 1; k <= 3; k++) {
      vec3 q = p + way * texel * float(k * k) * 1.1;
      bool there = all(greaterThan(q, low)) && all(lessThan(q, high));
      hidden += there ? smoothstep(0.3, -0.3, solid(q) / texel) / float(k) : 0.0;
    }
  }
  float open_ = clamp(1.0 - hidden / 10.0, 0.05, 1.0);
  color = vec4(lit(cap ? CUT : outer ? OWN : BONE, normal, open_), 1.0);
}`;

// The mean of the passes, coded as sRGB.
const SHOWN = `#version 300 es
precision highp float;
uniform sampler2D sum;
uniform float passes;
uniform vec2 pixels, of;
out vec4 color;
void main() {
  vec4 s = texture(sum, gl_FragCoord.xy / of * pixels / vec2(textureSize(sum, 0))) / passes;
  vec3 c = s.a > 0.0 ? clamp(s.rgb / s.a, 0.0, 1.0) : vec3(0.0);
  c = mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
  color = vec4(c * s.a, s.a);
}`;
