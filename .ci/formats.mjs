// Validates .glb files with Khronos' glTF validator. The validator does not support KHR_gaussian_splatting: it reports one message
// for the extension and one for each attribute of it. The script allows these messages and no others; for a mesh it allows none.
import { readFileSync } from 'node:fs';
import validator from 'gltf-validator';

const document = (bytes) => JSON.parse(bytes.subarray(20, 20 + bytes.readUInt32LE(12)).toString());

async function faults(bytes) {
    const { issues } = await validator.validateBytes(new Uint8Array(bytes), { maxIssues: 0 });
    const isKnown = ({ code, pointer, message }) =>
        (code === 'UNSUPPORTED_EXTENSION' && message.includes('KHR_gaussian_splatting')) ||
        (code === 'MESH_PRIMITIVE_INVALID_ATTRIBUTE' && /\/attributes\/KHR_gaussian_splatting:[A-Z0-9_]+$/.test(pointer));
    const { meshes, ...rest } = document(bytes);
    const isMesh = meshes[0].primitives[0].extensions === undefined;
    if (isMesh) return issues.messages;
    return [...issues.messages.filter((issue) => !isKnown(issue)), ...objectFaults({ meshes, ...rest })];
}

// Checks requirements of the extension's specification that the validator does not check.
function objectFaults({ meshes, extensionsUsed, accessors }) {
    const { mode, attributes, extensions } = meshes[0].primitives[0];
    const object = extensions.KHR_gaussian_splatting;
    const kinds = { POSITION: 'VEC3', ROTATION: 'VEC4', SCALE: 'VEC3', OPACITY: 'SCALAR', SH_DEGREE_0_COEF_0: 'VEC3' };
    const wrong = [];
    const ask = (truth, message) => truth || wrong.push({ message });
    ask(mode === 0, 'the mode of Gaussians must be 0 (points)');
    ask(extensionsUsed.includes('KHR_gaussian_splatting'), 'extensionsUsed does not list the extension');
    ask(object.kernel === 'ellipse', 'the kernel must be ellipse');
    ask(['srgb_rec709_display', 'lin_rec709_display'].includes(object.colorSpace), 'unknown colorSpace');
    for (const [name, kind] of Object.entries(kinds)) {
        const index = attributes[name === 'POSITION' ? name : `KHR_gaussian_splatting:${name}`];
        ask(accessors[index]?.type === kind, `the type of ${name} must be ${kind}`);
    }
    const counts = new Set(Object.values(attributes).map((index) => accessors[index].count));
    ask(counts.size === 1, 'the attributes differ in count');
    const degrees = Object.keys(attributes).filter((name) => name.includes(':SH_DEGREE_')).length;
    ask([1, 4, 9, 16].includes(degrees), 'a degree of spherical harmonics lacks coefficients');
    return wrong;
}

// The same file with its JSON document changed.
function changed(bytes, change) {
    const end = 20 + bytes.readUInt32LE(12);
    const json = document(bytes);
    change(json);
    let text = JSON.stringify(json);
    text = Buffer.from(text.padEnd(Math.ceil(text.length / 4) * 4));
    const head = Buffer.from(bytes.subarray(0, 20));
    head.writeUInt32LE(20 + text.length + bytes.length - end, 8);
    head.writeUInt32LE(text.length, 12);
    return Buffer.concat([head, text, bytes.subarray(end)]);
}

for (const file of process.argv.slice(2)) {
    const found = await faults(readFileSync(file));
    if (found.length > 0) throw new Error(`${file}: ${JSON.stringify(found, null, 1)}`);
}
// Controls: each of these errors must be detected.
const bytes = readFileSync(process.argv[2]);
const attribute = 'KHR_gaussian_splatting:OPACITY';
for (const change of [
    (json) => { json.accessors[0].count += 1; },
    (json) => { json.accessors[0].max = [0, 0, 0]; },
    (json) => { json.meshes[0].primitives[0].attributes.ALBEDO = 1; },
    (json) => { delete json.meshes[0].primitives[0].attributes[attribute]; },
    (json) => { delete json.meshes[0].primitives[0].extensions.KHR_gaussian_splatting.kernel; },
]) {
    if ((await faults(changed(bytes, change))).length === 0) throw new Error(`control failed: this check does not detect ${change}`);
}
console.log('the .glb files are valid, except for messages about KHR_gaussian_splatting');
