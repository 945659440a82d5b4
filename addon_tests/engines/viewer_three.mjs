// What the viewer takes of three.js; `npm run viewer` makes xihe_blender/viewer/three.min.js of it.
export {
  ClampToEdgeWrapping, DataTexture, DirectionalLight, EquirectangularReflectionMapping, Float32BufferAttribute, BufferGeometry,
  FloatType, HalfFloatType, LightProbe, LinearFilter, Matrix4, Mesh, NearestFilter, NoColorSpace, NoToneMapping, OrthographicCamera,
  PerspectiveCamera, PlaneGeometry, PMREMGenerator, RGBAFormat, RedFormat, SRGBColorSpace, Scene, ShaderChunk, ShaderMaterial,
  ShadowMaterial, Texture, Vector3, WebGLRenderTarget, WebGLRenderer, PCFShadowMap, REVISION,
} from "three";
export { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
export { HDRLoader } from "three/examples/jsm/loaders/HDRLoader.js";
