// node tools/check_export.mjs FILE...: checks exported files. Khronos' validator must find no errors or warnings in a
// .glb. gsplat's loader must read from a .ply the count, bounds and colours that are in its bytes.
import fs from 'node:fs';
import { createRequire } from 'node:module';
import { pathToFileURL } from 'node:url';

const from = createRequire(pathToFileURL(process.cwd() + '/').href);
let wrong = 0;
const complain = (path, text) => { console.error(`${path}: ${text}`); wrong = 1; };

async function glb(path) {
    const validator = from('gltf-validator');
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(path)), { maxIssues: 20 });
    const { numErrors, numWarnings, messages } = report.issues;
    for (const m of messages.slice(0, 20)) console.error(`${path}: ${m.code} ${m.pointer ?? ''}: ${m.message}`);
    if (numErrors || numWarnings) complain(path, `${numErrors} errors, ${numWarnings} warnings`);
    const i = report.info;
    console.log(`${path}: ${numErrors} errors, ${numWarnings} warnings; ${i.totalVertexCount} vertices, ` +
        `${i.totalTriangleCount} triangles, ${i.animationCount} animations`);
}

// The values in the file's bytes, in the header's order of properties (all are floats).
function raw(path) {
    const bytes = fs.readFileSync(path), end = bytes.indexOf('end_header\n') + 11;
    const lines = bytes.subarray(0, end).toString('latin1').split('\n');
    const names = lines.filter(l => l.startsWith('property float ')).map(l => l.slice(15));
    const count = Number(lines.find(l => l.startsWith('element vertex ')).slice(15));
    const value = (row, name) => bytes.readFloatLE(end + 4 * (row * names.length + names.indexOf(name)));
    if (bytes.length !== end + 4 * count * names.length) complain(path, 'is not as long as its header says');
    return { bytes, count, value };
}

async function splats(path) {
    globalThis.window ??= globalThis; // the loader is written for a browser
    globalThis.self ??= globalThis;
    globalThis.Worker ??= class { postMessage() {} terminate() {} };
    const { PLYLoader, Scene } = await import(pathToFileURL(from.resolve('gsplat').replace(/gsplat\/.*$/,
        'gsplat/dist/index.es.js')).href);
    const own = raw(path), b = own.bytes;
    const splat = PLYLoader.LoadFromArrayBuffer(b.buffer.slice(b.byteOffset, b.byteOffset + b.length), new Scene());
    if (splat.data.vertexCount !== own.count) complain(path, `read ${splat.data.vertexCount} of ${own.count} splats`);
    for (const axis of ['x', 'y', 'z']) {
        let low = Infinity, high = -Infinity;
        for (let i = 0; i < own.count; i++) {
            low = Math.min(low, own.value(i, axis));
            high = Math.max(high, own.value(i, axis));
        }
        if (Math.abs(splat.bounds.min[axis] - low) > 1e-5 || Math.abs(splat.bounds.max[axis] - high) > 1e-5)
            complain(path, `bounds along ${axis} are read as ${splat.bounds.min[axis]} to ${splat.bounds.max[axis]}`);
    }
    let off = 0;
    for (let i = 0; i < own.count; i++)
        for (let k = 0; k < 3; k++) {
            const color = 255 * (0.5 + 0.28209479177387814 * own.value(i, `f_dc_${k}`));
            off = Math.max(off, Math.abs(color - splat.data.colors[4 * i + k]));
            if (!(color > -1 && color < 256)) complain(path, `splat ${i} has no colour`);
            const scale = Math.exp(own.value(i, `scale_${k}`));
            if (Math.abs(scale - splat.data.scales[3 * i + k]) > 1e-3 * scale) complain(path, `splat ${i}: scale`);
        }
    if (off > 1.01) complain(path, `colours are read ${off} of 255 off`);
    console.log(`${path}: ${splat.data.vertexCount} splats read, colours within ${off.toFixed(2)} of 255`);
}

for (const path of process.argv.slice(2)) await (path.endsWith('.glb') ? glb : splats)(path);
process.exit(wrong);
