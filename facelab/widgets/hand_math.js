// What the hand on a face computes: rays, normals, and how a face follows a pull.
// Arrays are flat, row by row; numbers are doubles but for what goes to the graphics card.

// Solves S x = r for a small symmetric positive definite S of n rows (Cholesky), both overwritten.
function solveDefinite(S, r, n) {
  for (let j = 0; j < n; j++) {
    for (let k = 0; k < j; k++) {
      const s = S[j * n + k];
      for (let i = j; i < n; i++) S[i * n + j] -= S[i * n + k] * s;
    }
    const d = Math.sqrt(S[j * n + j]);
    for (let i = j; i < n; i++) S[i * n + j] /= d;
  }
  for (let i = 0; i < n; i++) {
    for (let k = 0; k < i; k++) r[i] -= S[i * n + k] * r[k];
    r[i] /= S[i * n + i];
  }
  for (let i = n - 1; i >= 0; i--) {
    for (let k = i + 1; k < n; k++) r[i] -= S[k * n + i] * r[k];
    r[i] /= S[i * n + i];
  }
  return r;
}

// The y that minimises (y - free)' A (y - free) / 2 + sum of beyond^2 / give / 2, where beyond is
// how far y lies outside lo and hi; with give = 0 it may not. M is the inverse of A. `side` says
// where each coefficient is: -1 at lo, 1 at hi, 0 free; it is where the search starts, and ends.
//
// Block principal pivoting: all on the wrong side change sides at once, and if their number has
// not fallen for ten rounds only the last of them does, which must end (Murty).
function solveWithin({ M, lo, hi, give }, free, side) {
  const n = free.length;
  const y = new Float64Array(n);
  let fewest = n + 1;
  let patience = 10;
  for (let i = 0; i < n; i++) if (lo[i] === hi[i]) side[i] = -1;
  for (let round = 0; round < 200 + 50 * n; round++) {
    const at = [];
    for (let i = 0; i < n; i++) if (side[i]) at.push(i);
    const k = at.length;
    const S = new Float64Array(k * k);
    const pressure = new Float64Array(k);
    at.forEach((i, a) => {
      at.forEach((j, b) => (S[a * k + b] = M[i * n + j]));
      S[a * k + a] += give[i];
      pressure[a] = free[i] - (side[i] < 0 ? lo[i] : hi[i]);
    });
    solveDefinite(S, pressure, k);
    y.set(free);
    at.forEach((i, a) => {
      for (let j = 0; j < n; j++) y[j] -= M[i * n + j] * pressure[a];
    });
    const wrong = [];
    for (let i = 0; i < n; i++)
      if (!side[i] && (y[i] < lo[i] - 1e-9 || y[i] > hi[i] + 1e-9)) wrong.push(i);
    at.forEach((i, a) => {
      if (side[i] * pressure[a] < -1e-12 && lo[i] !== hi[i]) wrong.push(i);
    });
    if (!wrong.length) break;
    if (wrong.length < fewest) [fewest, patience] = [wrong.length, 10];
    else if (patience) patience--;
    else wrong.splice(0, wrong.length, Math.max(...wrong));
    for (const i of wrong) side[i] = side[i] ? 0 : y[i] < lo[i] ? -1 : 1;
  }
  return y;
}

// rows (n by m, sparse: starts, columns, values) times X (m by 3), added to the n rows of `out`
// from `first` on.
function addProduct({ starts, columns, values }, X, out, first = 0) {
  for (let i = 0; i + 1 < starts.length; i++) {
    let x = 0, y = 0, z = 0;
    for (let k = starts[i]; k < starts[i + 1]; k++) {
      const j = 3 * columns[k];
      x += values[k] * X[j];
      y += values[k] * X[j + 1];
      z += values[k] * X[j + 2];
    }
    const o = 3 * (first + i);
    out[o] += x;
    out[o + 1] += y;
    out[o + 2] += z;
  }
}

// Unit normals of n vertices, each face counted by its area, into `out`.
function normalsOf(X, faces, nFaces, n, out) {
  out.fill(0, 0, 3 * n);
  for (let f = 0; f < 3 * nFaces; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ux = X[b] - X[a], uy = X[b + 1] - X[a + 1], uz = X[b + 2] - X[a + 2];
    const vx = X[c] - X[a], vy = X[c + 1] - X[a + 1], vz = X[c + 2] - X[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    for (const i of [a, b, c]) {
      out[i] += x;
      out[i + 1] += y;
      out[i + 2] += z;
    }
  }
  for (let i = 0; i < 3 * n; i += 3) {
    const length = Math.hypot(out[i], out[i + 1], out[i + 2]) || 1;
    for (let a = 0; a < 3; a++) out[i + a] /= length;
  }
}

// Where a ray first meets triangles (Moeller, Trumbore): {t, face}, or null. No ray slips through
// between two that share an edge: seen from the front, the middle of a face is one line of edges.
const EDGE = 1e-9; // of a triangle
function firstHit(origin, way, X, faces, nFaces) {
  const [ox, oy, oz] = origin;
  const [dx, dy, dz] = way;
  let best = null;
  for (let f = 0; f < nFaces; f++) {
    const a = 3 * faces[3 * f], b = 3 * faces[3 * f + 1], c = 3 * faces[3 * f + 2];
    const ux = X[b] - X[a], uy = X[b + 1] - X[a + 1], uz = X[b + 2] - X[a + 2];
    const vx = X[c] - X[a], vy = X[c + 1] - X[a + 1], vz = X[c + 2] - X[a + 2];
    const px = dy * vz - dz * vy, py = dz * vx - dx * vz, pz = dx * vy - dy * vx;
    const det = ux * px + uy * py + uz * pz;
    if (det === 0) continue;
    const sx = ox - X[a], sy = oy - X[a + 1], sz = oz - X[a + 2];
    const u = (sx * px + sy * py + sz * pz) / det;
    if (u < -EDGE || u > 1 + EDGE) continue;
    const qx = sy * uz - sz * uy, qy = sz * ux - sx * uz, qz = sx * uy - sy * ux;
    const v = (dx * qx + dy * qy + dz * qz) / det;
    if (v < -EDGE || u + v > 1 + EDGE) continue;
    const t = (vx * qx + vy * qy + vz * qz) / det;
    if (t > 0 && (!best || t < best.t)) best = { t, face: f };
  }
  return best;
}

// How a face follows a pull, from the kernel's answer to a press: `moved(pull, out)` adds the
// displacements of all skin vertices to `out`.
function follower(answer) {
  if (answer.kind === "affine") {
    const { D } = answer;
    return ([x, y, z], out) => {
      for (let i = 0, d = 0; d < D.length; i++, d += 3)
        out[i] += D[d] * x + D[d + 1] * y + D[d + 2] * z;
    };
  }
  if (answer.kind === "course") {
    const { D } = answer;
    return (shares, out) => {
      const size = D.length / shares.length;
      shares.forEach((by, k) => {
        for (let i = 0, d = k * size; i < size; i++, d++) out[i] += by * D[d];
      });
    };
  }
  const { start, free, slope, basis } = answer;
  const P = free.length;
  const side = new Int8Array(P);
  return ([x, y, z], out) => {
    const wanted = free.map((f, k) => f + slope[3 * k] * x + slope[3 * k + 1] * y + slope[3 * k + 2] * z);
    const c = solveWithin(answer, wanted, side);
    const size = basis.rows.length / P;
    const u = basis.weights ? new Float64Array(size) : out;
    for (let k = 0; k < P; k++) {
      const by = c[k] - start[k];
      if (by === 0) continue;
      for (let i = 0, r = k * size; i < size; i++, r++) u[i] += by * basis.rows[r];
    }
    if (basis.weights) addProduct(basis.weights, u, out);
  };
}

// Where a pull ends that may not leave a ball around what is sane; without one, where it is.
function capped(pull, start, ball) {
  if (!ball) return pull;
  const off = pull.map((p, a) => p + start[a] - ball.centre[a]);
  const length = Math.hypot(...off);
  if (length <= ball.radius) return pull;
  return off.map((o, a) => ball.centre[a] + (o * ball.radius) / length - start[a]);
}
