// Draws the avatar's baked surface by WebGL 2 while something moves. The program sends the surface once, in the rest
// pose, and a motion as matrices of the 24 joints (src/viewer/viewer.h has the bytes); the shader does the skinning.
"use strict";

const live = (() => {
  const HEAD = 16, FRAMING = 16, FRAME = 3 + 12 * 24, FRAMES = 128, CHUNKS_MAX = 64;
  const POLL_MS = 500, SLOW_MS = 42, QUICK_MS = 20, SCALE_LEAST = 0.35;
  const FOV_TAN = Math.tan((15 * Math.PI) / 180);
  const vertexSource = `#version 300 es
    uniform vec4 joint[72];
    uniform mat4 camera;
    layout(location = 0) in vec3 place;
    layout(location = 1) in vec2 at;
    layout(location = 2) in uvec4 number;
    layout(location = 3) in vec4 weight;
    out vec2 texel;
    void main() {
      vec4 row[3] = vec4[3](vec4(0), vec4(0), vec4(0));
      for (int i = 0; i < 4; i++)
        for (int r = 0; r < 3; r++) row[r] += weight[i] * joint[3 * int(number[i]) + r];
      vec4 p = vec4(place, 1);
      gl_Position = camera * vec4(dot(row[0], p), dot(row[1], p), dot(row[2], p), 1);
      texel = at;
    }`;
  const fragmentSource = `#version 300 es
    precision mediump float;
    uniform sampler2D picture;
    in vec2 texel;
    out vec4 color;
    void main() { color = vec4(texture(picture, texel).rgb, 1); }`;

  let canvas = null, gl = null, program = null, places = null;
  const surfaces = new Map(); // by avatar: "waits", "failed", or the surface
  const chunks = new Map();   // by avatar/motion/first frame: null while loading; the most recently used are last
  let told = () => {};        // called when something has arrived
  let scale = 1, last = 0, pace = 0;

  function shader(kind, source) {
    const s = gl.createShader(kind);
    gl.shaderSource(s, source);
    gl.compileShader(s);
    return s;
  }

  // False if the browser cannot draw it, or only without a graphics card, unless `forced`.
  function open(on, tell, forced) {
    canvas = on;
    told = tell;
    gl = canvas.getContext("webgl2", { antialias: true,
      preserveDrawingBuffer: true, failIfMajorPerformanceCaveat: !forced });
    if (!gl || (!forced && isSoftware())) return false;
    canvas.addEventListener("webglcontextlost", (e) => { e.preventDefault(); program = null; surfaces.clear(); });
    canvas.addEventListener("webglcontextrestored", () => { prepare(); told(); });
    return prepare();
  }

  // Not every browser reports this as a major caveat.
  function isSoftware() {
    const info = gl.getExtension("WEBGL_debug_renderer_info");
    return /swiftshader|llvmpipe|softpipe|software/i.test(
      gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  }

  function prepare() {
    const p = gl.createProgram();
    gl.attachShader(p, shader(gl.VERTEX_SHADER, vertexSource));
    gl.attachShader(p, shader(gl.FRAGMENT_SHADER, fragmentSource));
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS)) return false;
    program = p;
    places = { joint: gl.getUniformLocation(p, "joint"), camera: gl.getUniformLocation(p, "camera") };
    gl.useProgram(p);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    return true;
  }

  function attribute(place, size, type, integer, normalized, bytes) {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, bytes, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    if (integer) gl.vertexAttribIPointer(place, size, type, 0, 0);
    else gl.vertexAttribPointer(place, size, type, normalized, 0, 0);
  }

  async function upload(bytes) {
    const [, corners, triangles, png] = new Uint32Array(bytes, 0, 4);
    let at = HEAD;
    const take = (n) => new Uint8Array(bytes, (at += n) - n, n);
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    attribute(0, 3, gl.FLOAT, false, false, take(12 * corners));
    attribute(1, 2, gl.UNSIGNED_SHORT, false, true, take(4 * corners));
    attribute(2, 4, gl.UNSIGNED_BYTE, true, false, take(4 * corners));
    attribute(3, 4, gl.UNSIGNED_BYTE, false, true, take(4 * corners));
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, take(12 * triangles), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    const picture = await createImageBitmap(new Blob([take(png)], { type: "image/png" }),
      { colorSpaceConversion: "none" });
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, picture);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    picture.close();
    return { vao, texture, count: 3 * triangles };
  }

  // Requests the avatar's surface until it is ready.
  async function load(avatar) {
    if (!program || surfaces.has(avatar)) return;
    surfaces.set(avatar, "waits");
    try {
      let answer;
      while ((answer = await fetch("surface?avatar=" + avatar, { cache: "no-store" })).status === 202)
        await new Promise((done) => setTimeout(done, POLL_MS));
      if (!answer.ok) throw new Error(answer.status);
      surfaces.set(avatar, await upload(await answer.arrayBuffer()));
      told();
    } catch {
      surfaces.set(avatar, "failed"); // pictures are requested instead
    }
  }

  const name = (avatar, motion, frame) => `${avatar}/${motion}/${Math.floor(frame / FRAMES)}`;

  async function fetchMoves(avatar, motion, frame) {
    const key = name(avatar, motion, frame);
    if (chunks.has(key)) return;
    chunks.set(key, null);
    try {
      const first = Math.floor(frame / FRAMES) * FRAMES;
      const answer = await fetch("moves?" + new URLSearchParams({ avatar, motion, frame: first }),
        { cache: "no-store" });
      if (!answer.ok) throw new Error(answer.status);
      chunks.set(key, new Float32Array(await answer.arrayBuffer(), HEAD));
      for (const old of chunks.keys()) if (chunks.size > CHUNKS_MAX && old !== key) chunks.delete(old);
      told();
    } catch {
      setTimeout(() => chunks.delete(key), 2000);
    }
  }

  // Whether frame n of the motion's `frames` can be drawn; requests missing frames and the next ones.
  function ready(avatar, motion, n, frames) {
    if (!program) return false;
    load(avatar);
    fetchMoves(avatar, motion, n);
    fetchMoves(avatar, motion, (n + FRAMES / 2) % frames);
    return typeof surfaces.get(avatar) === "object" && !!chunks.get(name(avatar, motion, n));
  }

  // The viewer's camera (src/viewer/scene.c) as a matrix to clip space, column by column; and the height of the view in
  // metres.
  function cameraOf(f, way, view, width, height) {
    const { cos, sin, hypot, max, min } = Math;
    const axes = f.subarray(0, 9), centre = f.subarray(9, 12), half = f.subarray(12, 15), distance = f[15];
    const ca = cos(view.azimuth), sa = sin(view.azimuth), ce = cos(view.elevation), se = sin(view.elevation);
    const upright = [ca, 0, -sa, sa * se, -ce, ca * se, -sa * ce, -se, -ca * ce];
    const across = hypot(half[0], half[2]), wide = max(half[0], half[2]), tall = max(half[1], 0.5 * across);
    const focal = min((0.5 * height) / (1.08 * tall), (0.5 * width) / (1.08 * wide)) * (distance - across) * view.zoom;
    const target = [0, 1, 2].map((i) => centre[i] + (view.follow ? way[i] : 0) +
      axes[3 * i] * view.offset[0] + axes[3 * i + 1] * view.offset[1] + axes[3 * i + 2] * view.offset[2]);
    const rows = [0, 1, 2].map((r) => {
      const row = [0, 1, 2].map((j) => upright[3 * r] * axes[3 * j] + upright[3 * r + 1] * axes[3 * j + 1] +
        upright[3 * r + 2] * axes[3 * j + 2]);
      row.push((r === 2 ? distance : 0) - row[0] * target[0] - row[1] * target[1] - row[2] * target[2]);
      return row;
    });
    const near = 0.05, far = 4 * distance + 20, sx = (2 * focal) / width, sy = (-2 * focal) / height;
    const a = (far + near) / (far - near), b = (-2 * far * near) / (far - near), m = new Float32Array(16);
    for (let k = 0; k < 4; k++) {
      m[4 * k] = sx * rows[0][k] + rows[2][k] / width; // pixel centres of frames are at whole numbers
      m[4 * k + 1] = sy * rows[1][k] - rows[2][k] / height;
      m[4 * k + 2] = a * rows[2][k] + (k === 3 ? b : 0);
      m[4 * k + 3] = rows[2][k];
    }
    return { matrix: m, metres: (distance * height) / focal };
  }

  // Uses fewer pixels if drawing all of them is slow.
  function adapt() {
    const now = performance.now(), since = now - last;
    last = now;
    if (since > 200) return;
    pace = pace ? 0.9 * pace + 0.1 * since : since;
    if (pace > SLOW_MS && scale > SCALE_LEAST) { scale = Math.max(0.8 * scale, SCALE_LEAST); pace = 0; }
    else if (pace < QUICK_MS && scale < 1) scale = Math.min(scale * 1.01, 1);
  }

  // Draws a frame for which ready() was true. ground: [r, g, b, a], 0 to 1.
  function draw(view, n, width, height, ground) {
    adapt();
    const key = name(view.avatar, view.motion, n), chunk = chunks.get(key), s = surfaces.get(view.avatar);
    chunks.delete(key);
    chunks.set(key, chunk);
    const w = Math.max(1, Math.round(scale * width)), h = Math.max(1, Math.round(scale * height));
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const from = FRAMING + FRAME * (n % FRAMES);
    const { matrix, metres } = cameraOf(chunk.subarray(0, FRAMING), chunk.subarray(from, from + 3), view, w, h);
    gl.viewport(0, 0, w, h);
    gl.clearColor(ground[0] * ground[3], ground[1] * ground[3], ground[2] * ground[3], ground[3]);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniform4fv(places.joint, chunk.subarray(from + 3, from + FRAME));
    gl.uniformMatrix4fv(places.camera, false, matrix);
    gl.bindTexture(gl.TEXTURE_2D, s.texture);
    gl.bindVertexArray(s.vao);
    gl.drawElements(gl.TRIANGLES, s.count, gl.UNSIGNED_INT, 0);
    return { width: w, height: h, metres };
  }

  return { open, ready, draw };
})();
