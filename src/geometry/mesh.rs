//! Triangle meshes.

/// Vertices, and triangles between them that are seen counter-clockwise from outside.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriangleMesh {
    /// Positions.
    pub vertices: Vec<[f64; 3]>,
    /// Unit normals of the vertices, outwards; zero where there is none. None when the surface has one side only.
    pub normals: Option<Vec<[f64; 3]>>,
    /// Positions of the vertices in their list.
    pub faces: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// Volume within the mesh if it is closed, positive when its faces are seen counter-clockwise from outside: `⅙ Σ det(a, b, c)`
    /// about its first vertex. Cost: one pass over the faces.
    pub fn signed_volume(&self) -> f64 {
        let Some(origin) = self.vertices.first() else { return 0.0 };
        let at = |i: u32| -> [f64; 3] { [0, 1, 2].map(|c| self.vertices[i as usize][c] - origin[c]) };
        let six_fold = |face: &[u32; 3]| {
            let [a, b, c] = face.map(at);
            a[0] * (b[1] * c[2] - b[2] * c[1])
                + a[1] * (b[2] * c[0] - b[0] * c[2])
                + a[2] * (b[0] * c[1] - b[1] * c[0])
        };
        self.faces.iter().map(six_fold).sum::<f64>() / 6.0
    }
}
