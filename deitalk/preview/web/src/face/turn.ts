/** Turn of the head on its neck, the same mathematics as `rig.face.accents` in Python. */

import * as THREE from "three";

const DEGREE = Math.PI / 180;

/** Turn vertices (V * 3) in place by yaw, pitch, roll (degrees) and a shift (cm), each by its share. */
export function turnHead(
  vertices: Float32Array, track: ArrayLike<number>, joint: number[], share: Float32Array,
): void {
  const [yaw, pitch, roll, x, y, z] = Array.from(track);
  const euler = new THREE.Euler(-pitch * DEGREE, -yaw * DEGREE, roll * DEGREE, "YXZ");
  const pivot = new THREE.Vector3(...joint);
  const matrix = new THREE.Matrix4().makeRotationFromEuler(euler);
  matrix.setPosition(pivot.clone().sub(pivot.clone().applyEuler(euler)).add(new THREE.Vector3(x, y, z)));
  const point = new THREE.Vector3();
  for (let v = 0, k = 0; v < share.length; v++, k += 3) {
    point.fromArray(vertices, k).applyMatrix4(matrix);
    vertices[k] += share[v] * (point.x - vertices[k]);
    vertices[k + 1] += share[v] * (point.y - vertices[k + 1]);
    vertices[k + 2] += share[v] * (point.z - vertices[k + 2]);
  }
}
