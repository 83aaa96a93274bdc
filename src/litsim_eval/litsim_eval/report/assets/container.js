// Plain values and arrays, unpacked: see report/packing.py for the container.

const KINDS = { int8: Int8Array, int16: Int16Array, int32: Int32Array };

// The plain values, with the typed arrays by name as `arrays`.
async function unpack(base64) {
  const text = atob(base64.trim());
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  const start = 4 + new DataView(buffer).getUint32(0, true);
  const content = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, start - 4)));
  const arrays = {};
  for (const each of content.arrays) arrays[each.name] = restore(buffer, start, each);
  return { ...content, arrays };
}

function restore(buffer, start, { kind, shape, offset, resolution, differences }) {
  const count = shape.reduce((a, b) => a * b, 1);
  const whole = Int32Array.from(new KINDS[kind](buffer, start + offset, count));
  const length = shape[shape.length - 1];
  for (let n = 0; n < differences; n++) {
    for (let i = 0; i < count; i++) if (i % length) whole[i] += whole[i - 1];
  }
  if (resolution === 1) return whole;
  const values = new Float32Array(count);
  for (let i = 0; i < count; i++) values[i] = whole[i] * resolution;
  return values;
}
