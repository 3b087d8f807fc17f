// Shared by the pages that show a scan in 3D. A page has a <canvas id="view"> and an element "facts", and defines
// `draw` and `state`: the camera circles `target` at the distance `away`, m, within `reach`; angles are degrees, and the
// elevation is at least `lowest`.
const byId = id => document.getElementById(id);
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;
const canvas = byId("view");
const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
if (!gl) { byId("facts").textContent = "This browser has no WebGL 2."; throw new Error("no WebGL 2"); }

// Matrices are columns, as WebGL takes them.
const multiply = (a, b) => {
  const c = new Float32Array(16);
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++)
    for (let k = 0; k < 4; k++) c[4 * j + i] += a[4 * k + i] * b[4 * j + k];
  return c;
};
const minus = (a, b) => a.map((x, i) => x - b[i]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const n = Math.hypot(...a); return a.map(x => x / n); };
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const rad = Math.PI / 180, SUN = unit([-0.30, -0.52, 0.80]);

function program(vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return new Proxy({}, { get: (_, name) => name === "use" ? () => gl.useProgram(made) : gl.getUniformLocation(made, name) });
}
const surface = program(`
layout(location = 0) in vec3 at;
uniform mat4 clip, pose; uniform vec3 low, size;
out vec3 place;
void main() { vec4 p = pose * vec4(low + size * at, 1.0); place = p.xyz; gl_Position = clip * p; }`, `
in vec3 place; out vec4 shown;
uniform vec3 colour, eye, sun; uniform float opacity;
void main() {
  vec3 n = normalize(cross(dFdx(place), dFdy(place))), to = normalize(eye - place);
  if (dot(n, to) < 0.0) n = -n;
  vec3 half_way = normalize(to + sun);
  float lit = max(dot(n, sun), 0.0);
  vec3 light = colour * colour * ((0.26 + 0.10 * (1.0 + n.z)) * (0.75 + 0.25 * dot(n, to)) + 0.62 * lit)
    + 0.1 * step(0.001, lit) * pow(max(dot(n, half_way), 0.0), 32.0);
  shown = vec4(opacity < 1.0 ? colour : sqrt(light), opacity);
}`);

function attribute(index, array, count, type) {
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
  gl.enableVertexAttribArray(index);
  gl.vertexAttribPointer(index, count, type, true, 0, 0);
}
function solid(vertices, faces) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  attribute(0, vertices, 3, gl.UNSIGNED_SHORT);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  return { array, count: faces.length };
}

function camera() {
  const level = Math.cos(state.elevation * rad);
  const towards = [level * Math.cos(state.azimuth * rad), level * Math.sin(state.azimuth * rad), Math.sin(state.elevation * rad)];
  const eye = state.target.map((x, i) => x + state.away * towards[i]);
  const right = unit(cross([0, 0, 1], towards)), up = cross(towards, right);
  const view = new Float32Array([right[0], up[0], towards[0], 0, right[1], up[1], towards[1], 0, right[2], up[2], towards[2], 0,
    -dot(right, eye), -dot(up, eye), -dot(towards, eye), 1]);
  const aspect = canvas.width / canvas.height, f = 1 / Math.tan(17 * rad) / Math.max(1, 1 / aspect), near = Math.min(0.02, state.away / 20), far = 30;
  const lens = new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (near + far) / (near - far), -1, 0, 0, 2 * near * far / (near - far), 0]);
  return { clip: multiply(lens, view), eye, right, up, f };
}
// Clears the canvas in its size on the screen.
function clear(red, green, blue) {
  canvas.width = canvas.clientWidth * devicePixelRatio;
  canvas.height = canvas.clientHeight * devicePixelRatio;
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.clearColor(red, green, blue, 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.DEPTH_TEST);
}
let asked = false;
function redraw() { if (!asked) { asked = true; requestAnimationFrame(() => { asked = false; draw(); }); } }

canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
canvas.addEventListener("contextmenu", event => event.preventDefault());
canvas.addEventListener("pointermove", event => {
  if (!event.buttons) return;
  if (event.buttons === 1 && !event.shiftKey) {
    state.azimuth -= 0.3 * event.movementX;
    state.elevation = Math.min(Math.max(state.elevation + 0.3 * event.movementY, state.lowest), 89);
  } else {
    const { right, up } = camera(), scale = state.away * 0.61 / canvas.clientHeight;
    state.target = state.target.map((x, i) => x + scale * (up[i] * event.movementY - right[i] * event.movementX));
  }
  redraw();
});
canvas.addEventListener("wheel", event => {
  event.preventDefault();
  state.away = Math.min(Math.max(state.away * Math.exp(0.001 * event.deltaY), state.reach[0]), state.reach[1]);
  redraw();
}, { passive: false });
addEventListener("resize", redraw);
