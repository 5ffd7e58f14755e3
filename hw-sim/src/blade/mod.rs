//! Blades: four built-in ones lofted from parametric sections, and any other from an STL file.
//!
//! The blade frame: z is the stacking axis and the turning axis, pointing from root to tip; the origin lies in the
//! middle of the body's extent along z, and the cross-sections lie roughly centred on z, so that turning and tilting
//! about the origin keeps the body in view. x points roughly from leading to trailing edge. All lengths are mm.

mod airfoil;
mod designs;
mod foot;
mod section;
pub mod stl;

use nalgebra::{Point3, Vector3};

/// A closed triangle surface in mm, outward normals, triangles counter-clockwise seen from outside.
///
/// It may consist of several closed components that overlap; what a ray from outside meets first is the blade's skin.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// Corner points, mm, each shared by the triangles around it.
    pub vertices: Vec<Point3<f64>>,
    /// Vertex indices of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Lowest and highest coordinate along each axis, mm. `None` for a mesh without vertices.
    pub fn extents_mm(&self) -> Option<(Point3<f64>, Point3<f64>)> {
        let first = *self.vertices.first()?;
        Some(
            self.vertices
                .iter()
                .fold((first, first), |(low, high), point| (low.inf(point), high.sup(point))),
        )
    }

    /// Enclosed volume, mm³: positive when the triangles face outward; where components overlap the volume counts twice.
    ///
    /// Sum of the signed tetrahedra from the origin (divergence theorem).
    pub fn volume_mm3(&self) -> f64 {
        self.triangles
            .iter()
            .map(|triangle| {
                let [a, b, c] = self.corners(triangle);
                a.coords.dot(&b.coords.cross(&c.coords)) / 6.0
            })
            .sum()
    }

    /// The three corner points of one triangle of this mesh, mm.
    pub fn corners(&self, triangle: &[u32; 3]) -> [Point3<f64>; 3] {
        triangle.map(|index| self.vertices[index as usize])
    }

    /// Adds a component; its triangles keep their order behind those already there.
    pub(crate) fn append(&mut self, component: Mesh) {
        let offset = u32::try_from(self.vertices.len()).expect("built-in blades have far fewer than 2^32 vertices");
        self.vertices.extend(component.vertices);
        self.triangles.extend(
            component
                .triangles
                .iter()
                .map(|triangle| triangle.map(|index| index + offset)),
        );
    }

    /// Moves every vertex by the same vector, mm.
    pub(crate) fn translate(&mut self, shift_mm: Vector3<f64>) {
        for vertex in &mut self.vertices {
            *vertex += shift_mm;
        }
    }
}

/// A blade that is generated rather than read from a file. The shapes are *assumed*: typical proportions, no real part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Builtin {
    /// Low-pressure turbine blade: a bare, strongly twisted airfoil, 470 mm long.
    Lpt,
    /// Small high-pressure blade with platform and root, 50 mm overall.
    HptA,
    /// Large high-pressure blade with platform and root, 115 mm overall.
    HptB,
    /// Medium high-pressure blade with a strongly skewed platform and root, 75 mm overall.
    HptC,
}

impl Builtin {
    /// Every built-in blade, in the order of their names' first mention in the documentation.
    pub const ALL: [Builtin; 4] = [Builtin::Lpt, Builtin::HptA, Builtin::HptB, Builtin::HptC];

    /// The blade of that name (`lpt`, `hpt-a`, `hpt-b`, `hpt-c`); `None` for any other text.
    pub fn from_name(name: &str) -> Option<Builtin> {
        Builtin::ALL.into_iter().find(|blade| blade.name() == name)
    }

    /// The name used in recipes (`cad = "builtin:<name>"`).
    pub fn name(self) -> &'static str {
        match self {
            Builtin::Lpt => "lpt",
            Builtin::HptA => "hpt-a",
            Builtin::HptB => "hpt-b",
            Builtin::HptC => "hpt-c",
        }
    }

    /// Generates the blade's surface: 60,000 to 110,000 triangles, within 3 µm of the smooth shape (5 µm in
    /// the fillet, 10 µm for `lpt`).
    pub fn mesh(self) -> Mesh {
        let mut mesh = match self {
            Builtin::Lpt => designs::lpt().mesh(),
            Builtin::HptA => designs::hpt_a().mesh(),
            Builtin::HptB => designs::hpt_b().mesh(),
            Builtin::HptC => designs::hpt_c().mesh(),
        };
        let (low, high) = mesh.extents_mm().expect("every design has an airfoil");
        mesh.translate(Vector3::new(0.0, 0.0, -(low.z + high.z) / 2.0));
        mesh
    }
}

/// Joins closed rings of equally many points into a tube and closes both ends by strips across the ring.
///
/// Each ring runs counter-clockwise seen from the side towards which the rings advance. Point `i` and point `n - i` of
/// the first and last ring face each other; points 0 and `n / 2` are the ends of the strip. `n` is even.
fn tube_with_strip_caps(rings: &[Vec<Point3<f64>>]) -> Mesh {
    let mut mesh = tube(rings);
    let n = index(rings[0].len());
    let last = index(rings.len() - 1) * n;
    for i in 0..n / 2 {
        let (a, b, c, d) = (i, i + 1, n - i - 1, (n - i) % n);
        for [p, q, r] in [[a, b, c], [a, c, d]] {
            if p != q && q != r && r != p {
                mesh.triangles.push([last + p, last + q, last + r]);
                mesh.triangles.push([p, r, q]);
            }
        }
    }
    mesh
}

/// Joins closed rings into a tube and closes both ends by fans from one point each.
fn tube_with_fan_caps(first: Point3<f64>, rings: &[Vec<Point3<f64>>], last: Point3<f64>) -> Mesh {
    let mut mesh = tube(rings);
    let n = index(rings[0].len());
    let top = index(rings.len() - 1) * n;
    let centre = index(mesh.vertices.len());
    mesh.vertices.extend([first, last]);
    for i in 0..n {
        let next = (i + 1) % n;
        mesh.triangles.push([centre, next, i]);
        mesh.triangles.push([centre + 1, top + i, top + next]);
    }
    mesh
}

fn tube(rings: &[Vec<Point3<f64>>]) -> Mesh {
    let n = index(rings[0].len());
    let mut triangles = Vec::with_capacity(rings.len() * rings[0].len() * 2);
    for ring in 0..index(rings.len() - 1) {
        for i in 0..n {
            let (a, b) = (ring * n + i, ring * n + (i + 1) % n);
            triangles.push([a, b, b + n]);
            triangles.push([a, b + n, a + n]);
        }
    }
    Mesh {
        vertices: rings.concat(),
        triangles,
    }
}

fn index(count: usize) -> u32 {
    u32::try_from(count).expect("built-in blades have far fewer than 2^32 vertices")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn assert_closed(mesh: &Mesh, name: &str) {
        let mut edges = BTreeMap::new();
        for &[a, b, c] in &mesh.triangles {
            for edge in [(a, b), (b, c), (c, a)] {
                *edges.entry(edge).or_insert(0) += 1;
            }
        }
        for (&(a, b), &count) in &edges {
            assert_eq!(count, 1, "{name}: edge {a}-{b} occurs {count} times");
            assert_eq!(edges.get(&(b, a)), Some(&1), "{name}: edge {a}-{b} has no neighbour");
        }
    }

    #[test]
    fn every_edge_of_every_blade_has_exactly_one_neighbour() {
        for blade in Builtin::ALL {
            assert_closed(&blade.mesh(), blade.name());
        }
    }

    #[test]
    fn every_blade_has_positive_volume_and_no_degenerate_triangle() {
        for blade in Builtin::ALL {
            let mesh = blade.mesh();
            assert!(mesh.volume_mm3() > 0.0, "{}", blade.name());
            for triangle in &mesh.triangles {
                let [a, b, c] = mesh.corners(triangle);
                let area_mm2 = (b - a).cross(&(c - a)).norm() / 2.0;
                assert!(area_mm2 > 1e-9, "{}: area {area_mm2} at {a}", blade.name());
            }
        }
    }

    #[test]
    fn every_blade_has_the_stated_length_and_number_of_triangles() {
        for (blade, length_mm, width_mm) in [
            (Builtin::Lpt, 470.0, 60.0),
            (Builtin::HptA, 50.0, 20.0),
            (Builtin::HptB, 115.0, 38.0),
            (Builtin::HptC, 75.0, 28.0),
        ] {
            let mesh = blade.mesh();
            let (low, high) = mesh.extents_mm().unwrap();
            let name = blade.name();
            assert!(
                (high.z - low.z - length_mm).abs() < 0.02 * length_mm,
                "{name}: {} long",
                high.z - low.z
            );
            assert!((high.z + low.z).abs() < 1e-9, "{name} is not centred along z");
            for (low_mm, high_mm) in [(low.x, high.x), (low.y, high.y)] {
                assert!(
                    low_mm > -width_mm && high_mm < width_mm,
                    "{name}: {low_mm} to {high_mm}"
                );
                assert!(
                    (low_mm + high_mm).abs() < 0.4 * (high_mm - low_mm),
                    "{name} is not centred on z"
                );
            }
            let count = mesh.triangles.len();
            assert!((20_000..=110_000).contains(&count), "{name}: {count} triangles");
        }
    }

    #[test]
    fn names_round_trip_and_other_names_are_none() {
        for blade in Builtin::ALL {
            assert_eq!(Builtin::from_name(blade.name()), Some(blade));
        }
        assert_eq!(Builtin::from_name("hpt-d"), None);
        assert_eq!(Builtin::from_name(""), None);
    }
}
