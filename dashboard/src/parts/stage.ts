/** The scene of one surface: light, camera, morph targets. */
import { Box3, Color, DirectionalLight, DoubleSide, Group, HemisphereLight, Mesh, MeshStandardMaterial, PerspectiveCamera, Scene, Sphere, Spherical, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

/** Where a camera is, for scenes that turn together. */
export type Place = [number, number, number];

export interface Stage {
  follow(place: Place): void;
  morph(weights: number[]): void;
  turn(across: number, up: number): void;
  resize(width: number, height: number): void;
  dispose(): void;
}

export async function createStage(element: HTMLElement, mesh: ArrayBuffer, width: number, height: number, dark: boolean, onTurn: (place: Place) => void): Promise<Stage> {
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
    one.material = new MeshStandardMaterial({ color: new Color(dark ? 0x6fb7c2 : 0x5b9aa5), roughness: 0.62, metalness: 0, side: DoubleSide, vertexColors: Boolean(one.geometry.attributes.color) });
    if (!one.geometry.attributes.normal) one.geometry.computeVertexNormals();
    meshes.push(one);
  });
  const sphere = new Box3().setFromObject(model).getBoundingSphere(new Sphere());
  const far = (sphere.radius || 1) / Math.sin((camera.fov / 2) * (Math.PI / 180)) * 0.92;
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
    follow(place) {
      following = true;
      camera.position.copy(controls.target).add(new Vector3(...place).multiplyScalar(far));
      controls.update();
      following = false;
      draw();
    },
    morph(weights) {
      for (const one of meshes) weights.forEach((weight, index) => { if (one.morphTargetInfluences && index < one.morphTargetInfluences.length) one.morphTargetInfluences[index] = weight; });
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
