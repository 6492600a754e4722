// A recording of an IMU in somebody's hands, in BROAD's columns: ten poses, each held for a moment, made here with a known scale and
// bias and without a magnetometer; the same once more, for its gyroscope; then it is turned every way, with one, in a known field and
// hard iron.
//     node turned.mjs FILE

import { writeFileSync } from 'node:fs';

// The first pose is held for longer: while it is, the script looks at what is said of a sensor without a magnetometer.
const RATE_HZ = 100, FIRST_S = 12, HOLD_S = 1.8, TURN_S = 0.8, GRAVITY_MPS2 = 9.80665;
const ROUND_S = 20, FIELD_UT = [0, 30, -38], HARD_IRON_UT = [4, -7, 12];
const SCALE = [1.02, 0.99, 1.01], BIAS_MPS2 = [0.1, -0.15, 0.2];
const GYRO_SCALE = [1.03, 0.98, 1.01], GYRO_BIAS_RADPS = [0.004, -0.003, 0.005];
// Where up is in the body: each side, then four in between.
const POSES = [[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0], [0, 1, 0], [1, 1, 1], [0, -1, 0], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]];

// The same noise each time (mulberry32), three of twelve uniforms for one that is nearly normal.
let state = 11;
const uniform = () => {
  state = (state + 0x6d2b79f5) | 0;
  let t = Math.imul(state ^ (state >>> 15), 1 | state);
  t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
  return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
};
const noise = (sigma) => 2 * sigma * (uniform() + uniform() + uniform() - 1.5);

const length = (v) => Math.hypot(...v);
const unit = (v) => v.map((x) => x / length(v));
const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];
const dot = (a, b) => a.reduce((sum, x, n) => sum + x * b[n], 0);
// About a unit axis (Rodrigues).
const turned = (v, axis, angle) => {
  const [c, s, along, across] = [Math.cos(angle), Math.sin(angle), dot(axis, v), cross(axis, v)];
  return v.map((x, n) => x * c + across[n] * s + axis[n] * along * (1 - c));
};

const rows = ['t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2,mx_uT,my_uT,mz_uT,ref_qw,ref_qx,ref_qy,ref_qz,ref_px_m,ref_py_m,ref_pz_m,movement'];
let tick = 0;
const sample = (up, rate, field = Array(3).fill('nan')) => {
  const gyro = rate.map((x, n) => (GYRO_SCALE[n] * x + GYRO_BIAS_RADPS[n] + noise(0.002)).toFixed(5));
  const accel = up.map((x, n) => (SCALE[n] * GRAVITY_MPS2 * x + BIAS_MPS2[n] + noise(0.03)).toFixed(4));
  rows.push([(tick / RATE_HZ).toFixed(4), ...gyro, ...accel, ...field, ...Array(7).fill('nan'), 0].join(','));
  tick += 1;
};
[...POSES, ...POSES].map(unit).forEach((up, n, all) => {
  for (let k = 0; k < (n === 0 ? FIRST_S : HOLD_S) * RATE_HZ; k += 1) sample(up, [0, 0, 0]);
  const next = all[n + 1];
  if (!next) return;
  const axis = unit(cross(up, next));
  const angle = Math.acos(dot(up, next));
  // The body turns the other way than what stands still in the world.
  const steps = TURN_S * RATE_HZ;
  for (let k = 0; k < steps; k += 1) sample(turned(up, axis, (angle * k) / steps), axis.map((x) => (-x * angle) / TURN_S));
});

// From the body to the world, by roll, pitch and yaw.
const attitude = (t) => {
  const [r, p, y] = [3 * Math.sin(0.62 * t), 1.4 * Math.cos(0.94 * t), 1.6 * t];
  const [cr, sr, cp, sp, cy, sy] = [Math.cos(r), Math.sin(r), Math.cos(p), Math.sin(p), Math.cos(y), Math.sin(y)];
  return [[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], [-sp, cp * sr, cp * cr]];
};
const inBody = (m, v) => [0, 1, 2].map((n) => m.reduce((sum, row, k) => sum + row[n] * v[k], 0));
const column = (m, n) => m.map((row) => row[n]);
for (let k = 0; k < ROUND_S * RATE_HZ; k += 1) {
  const [m, next] = [attitude(k / RATE_HZ), attitude((k + 1) / RATE_HZ)];
  // Each axis of the body as it will be, seen from the body as it is.
  const [x, y] = [0, 1].map((n) => inBody(m, column(next, n)));
  const field = inBody(m, FIELD_UT).map((f, n) => (f + HARD_IRON_UT[n] + noise(0.4)).toFixed(3));
  sample(inBody(m, [0, 0, 1]), [y[2] * RATE_HZ, -x[2] * RATE_HZ, x[1] * RATE_HZ], field);
}
writeFileSync(process.argv[2], `${rows.join('\n')}\n`);
