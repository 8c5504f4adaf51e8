// The picture in space, drawn by the graphics card: meshes, lit from the eye, and lines.

const VERTEX = `#version 300 es
in vec3 position; in vec3 normal; in vec3 colour;
uniform mat4 matrix;
out vec3 facing; out vec3 tint;
void main() { gl_Position = matrix * vec4(position, 1.0); facing = normal; tint = colour; }`;

// A shell is seen through in the middle and dense at its rim, which outlines it on any ground.
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 facing; in vec3 tint;
uniform vec3 eye; uniform float shell;
out vec4 seen;
void main() {
  float size = length(facing);
  float straight = size > 0.0 ? abs(dot(facing, eye)) / size : 1.0;
  float edge = pow(1.0 - straight, 2.5);
  float dense = shell > 0.0 ? shell + (0.95 - shell) * edge : 1.0;
  vec3 lit = tint * (shell > 0.0 ? 1.0 : 0.55 + 0.45 * straight);
  seen = vec4(lit * dense, dense);
}`;

// Draws into a canvas: `draw(view, parts)` with parts {solid, shells, lines}, meshes all. Null
// where the browser has no WebGL 2.
function stageOn(canvas) {
  const gl = canvas.getContext("webgl2", { antialias: true });
  if (!gl) return null;
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  const at = Object.fromEntries(["matrix", "eye", "shell"].map(
    (name) => [name, gl.getUniformLocation(program, name)]));
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  ["position", "normal", "colour"].forEach((name, i) => {
    const place = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 36, 12 * i);
  });
  gl.enable(gl.DEPTH_TEST);
  gl.depthFunc(gl.LEQUAL);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);

  function put(mesh, kind) {
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(mesh.vertices), gl.DYNAMIC_DRAW);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(mesh.indices), gl.DYNAMIC_DRAW);
    gl.drawElements(kind, mesh.indices.length, gl.UNSIGNED_INT, 0);
  }

  function draw(view, { solid, shells, lines }) {
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(at.matrix, false, view.matrix);
    gl.uniform3fv(at.eye, view.eye);
    gl.uniform1f(at.shell, 0);
    put(lines, gl.LINES);
    put(solid, gl.TRIANGLES);
    gl.depthMask(false);
    for (const { mesh, dense } of shells) {
      gl.uniform1f(at.shell, dense);
      put(mesh, gl.TRIANGLES);
    }
    gl.depthMask(true);
  }
  return { draw };
}
