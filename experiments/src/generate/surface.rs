//! The skin of a blade: samples of it, and what a camera sees of it.

use std::error::Error;
use std::path::Path;

use hw_sim::blade::{Builtin, Mesh};
use nalgebra::{Point3, Vector3};
use parry3d_f64::math::Vector;
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::{CompositeShapeRef, TriMesh};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::mesh_file;

/// A triangle surface about its box's middle, the longest side along z.
pub(crate) struct Surface {
    mesh: TriMesh,
    corners: Vec<[Point3<f64>; 3]>,
    /// The area of the triangles before each, and after it the whole.
    area_up_to: Vec<f64>,
    /// Whether parts of it may lie inside others.
    has_inner_parts: bool,
    half: Vector3<f64>,
}

/// A point of the skin and its outward normal.
#[derive(Clone, Copy)]
pub(super) struct Hit {
    pub(super) point: Point3<f64>,
    pub(super) normal: Vector3<f64>,
}

impl Surface {
    /// The mesh in the frame of samples and poses, mm.
    pub(super) fn mesh(&self) -> Mesh {
        let to_point = |vertex: &Vector| Point3::new(vertex.x, vertex.y, vertex.z);
        Mesh {
            vertices: self.mesh.vertices().iter().map(to_point).collect(),
            triangles: self.mesh.indices().to_vec(),
        }
    }

    pub(crate) fn of_builtin(blade: Builtin) -> Result<Self, Box<dyn Error>> {
        Self::new(blade.mesh(), true)
    }

    pub(super) fn of_file(path: &Path) -> Result<Self, Box<dyn Error>> {
        Self::new(mesh_file::read(path)?, false)
    }

    fn new(mut mesh: Mesh, has_inner_parts: bool) -> Result<Self, Box<dyn Error>> {
        let (low, high) = extents(&mesh.vertices);
        let longest = (high - low).imax();
        let middle = nalgebra::center(&low, &high);
        for vertex in &mut mesh.vertices {
            let v = *vertex - middle;
            // A cyclic exchange of the axes keeps the mesh's handedness.
            *vertex = Point3::from(Vector3::from_fn(|axis, _| v[(axis + longest + 1) % 3]));
        }
        if mesh.volume_mm3() < 0.0 {
            for triangle in &mut mesh.triangles {
                triangle.swap(1, 2);
            }
        }
        let corners: Vec<_> = mesh.triangles.iter().map(|triangle| mesh.corners(triangle)).collect();
        let mut area_up_to = vec![0.0];
        for [a, b, c] in &corners {
            let area = (b - a).cross(&(c - a)).norm() / 2.0;
            area_up_to.push(area_up_to[area_up_to.len() - 1] + area);
        }
        let half = (high - low) / 2.0;
        Ok(Self {
            mesh: TriMesh::new(
                mesh.vertices.iter().map(|vertex| glam(&vertex.coords)).collect(),
                mesh.triangles,
            )?,
            corners,
            area_up_to,
            has_inner_parts,
            half: Vector3::from_fn(|axis, _| half[(axis + longest + 1) % 3]),
        })
    }

    /// The same surface with a longest half side of 1.
    pub(crate) fn normalised(&self) -> Self {
        let factor = 1.0 / self.half.max();
        let mesh = self.mesh.clone().scaled(Vector::new(factor, factor, factor));
        Self {
            mesh,
            corners: self
                .corners
                .iter()
                .map(|corners| corners.map(|corner| corner * factor))
                .collect(),
            area_up_to: self.area_up_to.iter().map(|area| area * factor * factor).collect(),
            has_inner_parts: self.has_inner_parts,
            half: self.half * factor,
        }
    }

    /// Half the length of the box's diagonal.
    pub(super) fn half_diagonal(&self) -> f64 {
        self.half.norm()
    }

    /// Points drawn evenly by area from the skin.
    pub(crate) fn sample(&self, count: usize, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
        let mut points = Vec::with_capacity(count);
        while points.len() < count {
            let hit = self.draw(rng);
            if !self.has_inner_parts || self.is_outside(&hit) {
                points.push(hit.point);
            }
        }
        points
    }

    /// Points drawn evenly by area from what a camera at `camera` sees.
    ///
    /// # Errors
    /// When it sees hardly anything.
    pub(super) fn sample_seen_from(
        &self,
        camera: &Point3<f64>,
        count: usize,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<Point3<f64>>, Box<dyn Error>> {
        let mut points = Vec::with_capacity(count);
        for _ in 0..1000 * count {
            let hit = self.draw(rng);
            if self.sees(camera, &hit) {
                points.push(hit.point);
                if points.len() == count {
                    return Ok(points);
                }
            }
        }
        Err("hardly anything of the surface is visible from the camera".into())
    }

    /// What the ray from `origin` along `direction` meets first, from outside.
    pub(super) fn hit(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<Hit> {
        let ray = Ray::new(glam(&origin.coords), glam(direction));
        let (triangle, distance) = CompositeShapeRef(&self.mesh).cast_local_ray(&ray, f64::MAX, false)?;
        let normal = self.normal(triangle as usize)?;
        (normal.dot(direction) < 0.0).then(|| Hit {
            point: origin + direction * distance,
            normal,
        })
    }

    /// Whether the segment from the camera to a point of the surface meets nothing else and comes from outside.
    pub(super) fn sees(&self, camera: &Point3<f64>, hit: &Hit) -> bool {
        let towards = camera - hit.point;
        if hit.normal.dot(&towards) <= 0.0 {
            return false;
        }
        let from = hit.point + hit.normal * self.skin();
        let ray = Ray::new(glam(&from.coords), glam(&(camera - from)));
        !self.mesh.intersects_local_ray(&ray, 1.0)
    }

    fn draw(&self, rng: &mut ChaCha8Rng) -> Hit {
        loop {
            let area = rng.random_range(0.0..self.area_up_to[self.corners.len()]);
            let triangle = self.area_up_to.partition_point(|before| *before <= area) - 1;
            let (mut u, mut v): (f64, f64) = (rng.random(), rng.random());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let [a, b, c] = self.corners[triangle];
            if let Some(normal) = self.normal(triangle) {
                let point = a + (b - a) * u + (c - a) * v;
                return Hit { point, normal };
            }
        }
    }

    fn normal(&self, triangle: usize) -> Option<Vector3<f64>> {
        let [a, b, c] = self.corners[triangle];
        (b - a).cross(&(c - a)).try_normalize(0.0)
    }

    /// Whether a point of the surface lies inside no other component: along a ray to the outside as many surfaces are
    /// entered as left.
    fn is_outside(&self, hit: &Hit) -> bool {
        let mut from = hit.point + hit.normal * self.skin();
        // Not along an axis of symmetry, so that edges are not met.
        let direction = (hit.normal + Vector3::new(0.0123, 0.0234, 0.0345)).normalize();
        let mut inside_count = 0;
        for _ in 0..CROSSING_MAX_COUNT {
            let ray = Ray::new(glam(&from.coords), glam(&direction));
            let Some((triangle, distance)) = CompositeShapeRef(&self.mesh).cast_local_ray(&ray, f64::MAX, false) else {
                break;
            };
            let leaves = self
                .normal(triangle as usize)
                .is_some_and(|normal| normal.dot(&direction) > 0.0);
            inside_count += if leaves { 1 } else { -1 };
            from += direction * (distance + self.skin());
        }
        inside_count == 0
    }

    /// A distance that is nothing beside the surface and much beside rounding.
    fn skin(&self) -> f64 {
        1e-6 * self.half.max()
    }
}

/// The lowest and the highest coordinate along each axis; the origin twice for no points.
pub(crate) fn extents(points: &[Point3<f64>]) -> (Point3<f64>, Point3<f64>) {
    let first = points.first().copied().unwrap_or_else(Point3::origin);
    points
        .iter()
        .fold((first, first), |(low, high), point| (low.inf(point), high.sup(point)))
}

fn glam(vector: &Vector3<f64>) -> Vector {
    Vector::new(vector.x, vector.y, vector.z)
}

/// Surfaces that a ray out of a blade crosses at most.
const CROSSING_MAX_COUNT: u32 = 100;

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn a_normalised_surface_has_a_longest_half_side_of_one_and_its_longest_side_along_z() {
        let mut mesh = Builtin::HptA.mesh();
        for vertex in &mut mesh.vertices {
            *vertex = Point3::new(vertex.z, vertex.x, vertex.y);
        }
        let surface = Surface::new(mesh, true).unwrap().normalised();
        let points = surface.sample(2000, &mut ChaCha8Rng::seed_from_u64(1));
        let (low, high) = extents(&points);
        assert!(high.z > 0.99 && high.z <= 1.0 && low.z < -0.99 && low.z >= -1.0);
        assert!(high.x < 0.8 && high.y < 0.8);
    }

    #[test]
    fn no_sampled_point_lies_inside_another_component() {
        let surface = Surface::of_builtin(Builtin::HptA).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let drawn: Vec<Hit> = (0..2000).map(|_| surface.draw(&mut rng)).collect();
        let outside = drawn.iter().filter(|hit| surface.is_outside(hit)).count();
        assert!(outside > 1500 && outside < 2000, "{outside}");
        // What a camera sees is outside.
        let camera = Point3::new(200.0, 100.0, 200.0);
        let seen: Vec<_> = drawn.iter().filter(|hit| surface.sees(&camera, hit)).collect();
        assert!(seen.len() > 300 && seen.iter().all(|hit| surface.is_outside(hit)));
    }
}
