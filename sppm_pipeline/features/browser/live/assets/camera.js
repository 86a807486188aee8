// The direction of view, as render/camera.py has it: z is up, and at azimuth -60 the x axis runs to the right.
class Camera {
  constructor() {
    this.reset();
  }

  reset() {
    this.azimuth = -60;
    this.elevation = 25;
    this.zoom = 1;
    this.shift = [0, 0]; // in heights of the picture
  }

  turn(dx, dy) {
    this.azimuth -= dx;
    this.elevation = Math.max(-90, Math.min(90, this.elevation + dy));
  }

  // Unit vectors right, up and towards the viewer.
  axes() {
    const a = (this.azimuth * Math.PI) / 180, e = (this.elevation * Math.PI) / 180;
    const [ca, sa, ce, se] = [Math.cos(a), Math.sin(a), Math.cos(e), Math.sin(e)];
    return [[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]];
  }
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

// The middle of points, seen along the axes of a camera, and the lengths that they take to the right and up.
function extent(axes, points) {
  const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  for (const p of points) {
    for (let a = 0; a < 2; a++) {
      const v = dot(axes[a], p);
      low[a] = Math.min(low[a], v);
      high[a] = Math.max(high[a], v);
    }
  }
  return { middle: [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2], span: [high[0] - low[0], high[1] - low[1]] };
}
