// The white sphere of radius 1 as a GLB, for engines that take their models from files: rough, without a highlight.
export function sphereGlb(rows = 96, columns = 192) {
  const positions = [];
  const indices = [];
  for (let row = 0; row <= rows; row++)
    for (let column = 0; column <= columns; column++) {
      const [polar, azimuth] = [(Math.PI * row) / rows, (2 * Math.PI * column) / columns];
      positions.push(Math.sin(polar) * Math.cos(azimuth), Math.cos(polar), -Math.sin(polar) * Math.sin(azimuth));
    }
  for (let row = 0; row < rows; row++)
    for (let column = 0; column < columns; column++) {
      const [a, b] = [row * (columns + 1) + column, (row + 1) * (columns + 1) + column];
      indices.push(a, b, a + 1, a + 1, b, b + 1);
    }
  const vertices = new Float32Array(positions);
  const triangles = new Uint16Array(indices);
  const n = positions.length / 3;
  const vector = { bufferView: 0, componentType: 5126, count: n, type: "VEC3", min: [-1, -1, -1], max: [1, 1, 1] };
  const material = {
    pbrMetallicRoughness: { baseColorFactor: [1, 1, 1, 1], metallicFactor: 0, roughnessFactor: 1 },
    extensions: { KHR_materials_specular: { specularFactor: 0 } },
  };
  const content = {
    asset: { version: "2.0" },
    extensionsUsed: ["KHR_materials_specular"],
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0 }],
    // On a sphere of radius 1 a point is its normal.
    meshes: [{ primitives: [{ attributes: { POSITION: 0, NORMAL: 0 }, indices: 1, material: 0 }] }],
    materials: [material],
    accessors: [vector, { bufferView: 1, componentType: 5123, count: triangles.length, type: "SCALAR" }],
    bufferViews: [
      { buffer: 0, byteOffset: 0, byteLength: vertices.byteLength, target: 34962 },
      { buffer: 0, byteOffset: vertices.byteLength, byteLength: triangles.byteLength, target: 34963 },
    ],
    buffers: [{ byteLength: vertices.byteLength + triangles.byteLength }],
  };
  let text = JSON.stringify(content);
  text += " ".repeat((4 - (text.length % 4)) % 4);
  const body = vertices.byteLength + triangles.byteLength;
  const padded = body + ((4 - (body % 4)) % 4);
  const glb = new Uint8Array(12 + 8 + text.length + 8 + padded);
  const view = new DataView(glb.buffer);
  const words = [0x46546c67, 2, glb.length, text.length, 0x4e4f534a];
  words.forEach((word, place) => view.setUint32(4 * place, word, true));
  glb.set(new TextEncoder().encode(text), 20);
  view.setUint32(20 + text.length, padded, true);
  view.setUint32(24 + text.length, 0x004e4942, true);
  glb.set(new Uint8Array(vertices.buffer), 28 + text.length);
  glb.set(new Uint8Array(triangles.buffer), 28 + text.length + vertices.byteLength);
  return glb;
}

// Linear RGBA of 8-bit sRGB pixels, over the exposure at which they were drawn.
export function decoded(bytes, exposure) {
  return Float32Array.from(bytes, (byte, place) => {
    const value = byte / 255;
    if (place % 4 === 3) return value;
    return (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4) / exposure;
  });
}
