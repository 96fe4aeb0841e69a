/** The scene of one surface: light, camera, morph targets. */
import {
  Box3,
  BufferAttribute,
  Color,
  DirectionalLight,
  DoubleSide,
  type Group,
  HemisphereLight,
  Mesh,
  MeshStandardMaterial,
  PerspectiveCamera,
  Scene,
  Sphere,
  Spherical,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

/** Where a camera is, for scenes that turn together. */
export type Place = [number, number, number];

/** Another surface of the same mesh, and in which direction differences count: to it (1), or from it (−1). */
export interface Other {
  mesh: ArrayBuffer;
  sign: 1 | -1;
}

export interface Stage {
  /** Length of the longest difference to the other surface, which has the strongest colours. */
  most: number;
  follow(place: Place): void;
  morph(weights: number[]): void;
  turn(across: number, up: number): void;
  resize(width: number, height: number): void;
  dispose(): void;
}

export async function createStage(
  element: HTMLElement,
  mesh: ArrayBuffer,
  width: number,
  height: number,
  dark: boolean,
  onTurn: (place: Place) => void,
  other?: Other,
): Promise<Stage> {
  const most = { value: 0 };
  const model = (await new GLTFLoader().parseAsync(mesh, "")).scene as Group;
  const renderer = new WebGLRenderer({ antialias: true, alpha: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  element.replaceChildren(renderer.domElement);
  const scene = new Scene();
  const camera = new PerspectiveCamera(35, width / height, 0.01, 1000);
  const lamp = new DirectionalLight(0xffffff, 1.9);
  lamp.position.set(-0.6, 0.9, 1.2);
  const sky = new HemisphereLight(0xffffff, dark ? 0x39424a : 0x9aa4aa, 1.6);
  sky.position.set(0, 0, 1);
  camera.add(lamp);
  scene.add(camera, sky, model);
  const meshes: Mesh[] = [];
  model.traverse((one) => {
    if (!(one instanceof Mesh)) return;
    meshes.push(one);
  });
  if (other)
    most.value = paint(
      meshes,
      meshesOf((await new GLTFLoader().parseAsync(other.mesh, "")).scene as Group),
      other.sign,
    );
  for (const one of meshes) {
    one.material = new MeshStandardMaterial({
      color: new Color(one.geometry.attributes.color ? 0xffffff : dark ? 0x6fb7c2 : 0x5b9aa5),
      roughness: 0.62,
      metalness: 0,
      side: DoubleSide,
      vertexColors: Boolean(one.geometry.attributes.color),
    });
    if (!one.geometry.attributes.normal) one.geometry.computeVertexNormals();
  }
  const sphere = new Box3().setFromObject(model).getBoundingSphere(new Sphere());
  // In a narrow frame it is the width that must hold the surface.
  const far =
    (((sphere.radius || 1) / Math.sin((camera.fov / 2) * (Math.PI / 180))) * 0.92) / Math.min(1, width / height);
  camera.position.copy(sphere.center).add(new Vector3(0.55, -0.75, 0.45).normalize().multiplyScalar(far));
  camera.up.set(0, 0, 1);
  camera.near = far / 100;
  camera.far = far * 10;
  const controls = new OrbitControls(camera, renderer.domElement);
  controls.target.copy(sphere.center);
  let asked = 0;
  const draw = () => {
    asked ||= requestAnimationFrame(() => {
      asked = 0;
      renderer.render(scene, camera);
    });
  };
  let following = false;
  controls.addEventListener("change", () => {
    draw();
    const { x, y, z } = camera.position.clone().sub(controls.target).divideScalar(far);
    if (!following) onTurn([x, y, z]);
  });
  const resize = (w: number, h: number) => {
    if (!w) return;
    renderer.setSize(w, h, false);
    renderer.domElement.style.width = "100%";
    renderer.domElement.style.height = `${h}px`;
    camera.aspect = w / h;
    camera.updateProjectionMatrix();
    draw();
  };
  resize(width, height);
  controls.update();
  return {
    most: most.value,
    follow(place) {
      following = true;
      camera.position.copy(controls.target).add(new Vector3(...place).multiplyScalar(far));
      controls.update();
      following = false;
      draw();
    },
    morph(weights) {
      for (const one of meshes)
        weights.forEach((weight, index) => {
          if (one.morphTargetInfluences && index < one.morphTargetInfluences.length)
            one.morphTargetInfluences[index] = weight;
        });
      draw();
    },
    turn(across, up) {
      const place = camera.position.clone().sub(controls.target);
      const upright = new Vector3(place.x, place.z, -place.y);
      const spherical = new Spherical().setFromVector3(upright);
      spherical.theta += across;
      spherical.phi = Math.min(Math.max(spherical.phi + up, 0.1), Math.PI - 0.1);
      upright.setFromSpherical(spherical);
      camera.position.copy(controls.target).add(new Vector3(upright.x, -upright.z, upright.y));
      controls.update();
      draw();
    },
    resize,
    dispose() {
      cancelAnimationFrame(asked);
      controls.dispose();
      renderer.dispose();
      element.replaceChildren();
    },
  };
}

function meshesOf(model: Group): Mesh[] {
  const meshes: Mesh[] = [];
  model.traverse((one) => {
    if (one instanceof Mesh) meshes.push(one);
  });
  return meshes;
}

/** Blue inwards, red outwards, grey where there is no difference; told apart also by the colour-blind. */
const INWARDS = new Color(0x2166ac),
  NONE = new Color(0xc9ccd0),
  OUTWARDS = new Color(0xb2182b);

/** Colours the vertices by their difference to those of the other meshes along the normals; the length of the longest one. */
function paint(own: Mesh[], other: Mesh[], sign: number): number {
  const parts = own.map(({ geometry }, at) => {
    if (!geometry.attributes.normal) geometry.computeVertexNormals();
    const [from, to, normal] = [
      geometry.attributes.position!,
      other[at]!.geometry.attributes.position!,
      geometry.attributes.normal!,
    ];
    const outwards = sign * (volume(geometry) < 0 ? -1 : 1);
    let longest = 0;
    const along = Float32Array.from({ length: from.count }, (_, k) => {
      const [x, y, z] = [to.getX(k) - from.getX(k), to.getY(k) - from.getY(k), to.getZ(k) - from.getZ(k)] as [
        number,
        number,
        number,
      ];
      longest = Math.max(longest, Math.hypot(x, y, z));
      return outwards * (x * normal.getX(k) + y * normal.getY(k) + z * normal.getZ(k));
    });
    return { geometry, along, longest };
  });
  const longest = Math.max(...parts.map((part) => part.longest));
  const size = Math.max(
    ...own.map(({ geometry }) => {
      geometry.computeBoundingSphere();
      return geometry.boundingSphere!.radius;
    }),
  );
  // Rounding is no difference.
  const most = longest > 1e-6 * size ? longest : 0;
  for (const { geometry, along } of parts) {
    const colours = new Float32Array(3 * along.length),
      colour = new Color();
    along.forEach((value, k) =>
      colour
        .copy(NONE)
        .lerp(value < 0 ? INWARDS : OUTWARDS, most ? Math.min(Math.abs(value) / most, 1) : 0)
        .toArray(colours, 3 * k),
    );
    geometry.setAttribute("color", new BufferAttribute(colours, 3));
  }
  return most;
}

/** Six times the volume within a mesh: its sign says whether the normals of the faces point outwards. */
function volume(geometry: Mesh["geometry"]): number {
  const { position } = geometry.attributes,
    index = geometry.index;
  if (!position || !index) return 1;
  const corner = (k: number) => new Vector3().fromBufferAttribute(position, index.getX(k));
  let sum = 0;
  for (let k = 0; k + 2 < index.count; k += 3) sum += corner(k).dot(corner(k + 1).cross(corner(k + 2)));
  return sum;
}
