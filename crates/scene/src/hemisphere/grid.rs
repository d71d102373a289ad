//! The nodes on which light is sought: the upper half of an icosahedron whose edges are divided into `frequency` parts
//! (method.md 2, eq. 5–7), and all of it where light comes from below the horizon as well.
//!
//! The icosahedron stands with the middle of an edge at the pole, and nodes on the rim count: so orientated, frequency 70
//! has the paper's 24,641 nodes. The points inside a face are spread by the weights sin(w θ) of its corners (θ = the angle
//! of an icosahedron's edge), which divides every edge into equal arcs. Projecting the flat face instead would crowd
//! nodes at the corners to twice the density of the middle, against the one solid angle ω = 2π/N that all have.

use glam::{DVec3, Quat, Vec3};

/// Nodes of light about an object.
#[derive(Clone, Debug)]
pub struct HemisphereGrid {
    /// Parts into which each edge of the icosahedron is divided.
    pub frequency: u32,
    /// Unit vector towards the pole.
    pub up: Vec3,
    /// Whether there are nodes below the horizon too.
    pub whole: bool,
    /// Distance of the nodes from the centre in mesh units, `None` where the light is distant.
    pub radius: Option<f32>,
    /// The object's centre.
    pub centre: Vec3,
    /// Unit direction of each node from the centre, in the world.
    pub directions: Vec<Vec3>,
    /// Solid angle of every node seen from the centre in steradians: 2π / number of nodes, 4π of the whole sphere's.
    pub solid_angle: f32,
    /// Neighbours of node `i` are `neighbour_list[neighbour_start[i]..neighbour_start[i + 1]]`, ascending.
    neighbour_start: Vec<u32>,
    neighbour_list: Vec<u32>,
    /// A node near the centre of each cell of the octahedral map of the hemisphere, and then of its mirror image below.
    cells: Vec<u32>,
    cells_per_side: u32,
    spacing: f32,
    /// Sine of the lowest elevation that still belongs to a rim node.
    lowest: f32,
    local_from_world: Quat,
}

/// Coordinates a + bφ (φ the golden ratio) of a point of the flat icosahedron, times the frequency: exact, so that the
/// nodes that faces share are recognised and the rim is found without rounding.
type Lattice = [(i32, i32); 3];

/// The icosahedron's corners: two of (0, ±1, ±φ) and their rotations per axis, so that ±z are middles of edges.
fn icosahedron() -> ([Lattice; 12], Vec<[usize; 3]>) {
    let mut corners = [[(0, 0); 3]; 12];
    let mut next = 0;
    for axis in 0..3 {
        for one in [1, -1] {
            for golden in [1, -1] {
                corners[next][(axis + 1) % 3] = (one, 0);
                corners[next][(axis + 2) % 3] = (0, golden);
                next += 1;
            }
        }
    }
    // Corners at distance 2 are joined; three that are joined pairwise are a face.
    let at = corners.map(place);
    let joined = |a: usize, b: usize| (at[a].distance(at[b]) - 2.0).abs() < 1e-9;
    let mut faces = Vec::with_capacity(20);
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if joined(a, b) && joined(b, c) && joined(a, c) {
                    faces.push([a, b, c]);
                }
            }
        }
    }
    (corners, faces)
}

fn golden_ratio() -> f64 {
    f64::midpoint(1.0, 5.0_f64.sqrt())
}

fn place(lattice: Lattice) -> DVec3 {
    let [x, y, z] = lattice.map(|(a, b)| f64::from(a) + f64::from(b) * golden_ratio());
    DVec3::new(x, y, z)
}

/// Nodes with the exact lattice point as key, and the node pairs joined by an edge, in local space (pole = +z).
struct Net {
    directions: Vec<DVec3>,
    edges: Vec<(u32, u32)>,
}

impl Net {
    fn new(frequency: u32, whole: bool) -> Self {
        let (corners, faces) = icosahedron();
        let f = frequency as usize;
        let edge_angle = (1.0 / 5.0_f64.sqrt()).acos();
        let mut points: Vec<(Lattice, DVec3)> =
            Vec::with_capacity(faces.len() * (f + 1) * (f + 2) / 2);
        for face in &faces {
            for i in 0..=f {
                for j in 0..=f - i {
                    points.push(node(&corners, *face, [f - i - j, i, j], edge_angle));
                }
            }
        }
        let mut nodes: Vec<(Lattice, DVec3)> = points
            .iter()
            .copied()
            .filter(|(lattice, _)| whole || place(*lattice).z >= 0.0)
            .collect();
        // Those below come last, so that the others have the same numbers with and without them.
        let key = |(lattice, _): &(Lattice, DVec3)| (place(*lattice).z < 0.0, *lattice);
        nodes.sort_unstable_by_key(key);
        nodes.dedup_by_key(|(lattice, _)| *lattice);
        let find = |point: &(Lattice, DVec3)| nodes.binary_search_by_key(&key(point), key).ok();
        let per_face = (f + 1) * (f + 2) / 2;
        let row = |i: usize| i * (2 * f + 3 - i) / 2;
        let mut edges = Vec::with_capacity(nodes.len() * 6);
        for face in points.chunks(per_face) {
            let index: Vec<Option<usize>> = face.iter().map(find).collect();
            let mut join = |a: usize, b: usize| {
                if let (Some(a), Some(b)) = (index[a], index[b]) {
                    edges.push((a as u32, b as u32));
                    edges.push((b as u32, a as u32));
                }
            };
            for i in 0..f {
                for j in 0..f - i {
                    join(row(i) + j, row(i) + j + 1);
                    join(row(i) + j, row(i + 1) + j);
                    join(row(i) + j + 1, row(i + 1) + j);
                }
            }
        }
        edges.sort_unstable();
        edges.dedup();
        Self {
            directions: nodes.into_iter().map(|(_, direction)| direction).collect(),
            edges,
        }
    }
}

/// The node with integer `weights` of a face's corners (their sum is the frequency).
fn node(
    corners: &[Lattice; 12],
    face: [usize; 3],
    weights: [usize; 3],
    edge_angle: f64,
) -> (Lattice, DVec3) {
    let frequency: usize = weights.iter().sum();
    let mut lattice = [(0, 0); 3];
    let mut direction = DVec3::ZERO;
    for (corner, weight) in face.into_iter().zip(weights) {
        for (sum, part) in lattice.iter_mut().zip(corners[corner]) {
            sum.0 += weight as i32 * part.0;
            sum.1 += weight as i32 * part.1;
        }
        direction += (edge_angle * weight as f64 / frequency as f64).sin() * place(corners[corner]);
    }
    if lattice[2] == (0, 0) {
        direction.z = 0.0;
    }
    (lattice, direction.normalize_or_zero())
}

impl HemisphereGrid {
    /// The grid above the horizon about `centre` with its pole towards `up` (any length but zero). `frequency` is held within 1
    /// to 200.
    pub fn new(frequency: u32, up: Vec3, radius: Option<f32>, centre: Vec3) -> Self {
        Self::build(frequency, up, radius, centre, false)
    }

    /// The same with nodes below the horizon too, after those above it.
    #[must_use]
    pub fn to_whole(&self) -> Self {
        Self::build(self.frequency, self.up, self.radius, self.centre, true)
    }

    /// A grid of another frequency over the same directions.
    #[must_use]
    pub fn at_frequency(&self, frequency: u32) -> Self {
        Self::build(frequency, self.up, self.radius, self.centre, self.whole)
    }

    fn build(frequency: u32, up: Vec3, radius: Option<f32>, centre: Vec3, whole: bool) -> Self {
        let frequency = frequency.clamp(1, 200);
        let up = up.try_normalize().unwrap_or(Vec3::Y);
        let world_from_local = Quat::from_rotation_arc(Vec3::Z, up);
        let net = Net::new(frequency, whole);
        let halves = if whole { 2.0 } else { 1.0 };
        let count = net.directions.len();
        let mut neighbour_start = vec![0_u32; count + 1];
        for &(from, _) in &net.edges {
            neighbour_start[from as usize + 1] += 1;
        }
        for i in 0..count {
            neighbour_start[i + 1] += neighbour_start[i];
        }
        let angles: f64 = net
            .edges
            .iter()
            .map(|&(a, b)| net.directions[a as usize].angle_between(net.directions[b as usize]))
            .sum();
        let spacing = (angles / net.edges.len().max(1) as f64) as f32;
        let mut grid = Self {
            frequency,
            up,
            whole,
            radius,
            centre,
            directions: net
                .directions
                .iter()
                .map(|d| (world_from_local * d.as_vec3()).normalize_or_zero())
                .collect(),
            solid_angle: (halves * std::f64::consts::TAU / count as f64) as f32,
            neighbour_start,
            neighbour_list: net.edges.iter().map(|&(_, to)| to).collect(),
            cells: Vec::new(),
            cells_per_side: ((2.0 * count as f32 / halves as f32).sqrt().ceil() as u32).max(1),
            spacing,
            lowest: -(0.5 * spacing).sin(),
            local_from_world: world_from_local.inverse(),
        };
        grid.fill_cells();
        grid
    }

    /// Every cell starts its search where the previous one ended: a step or two.
    fn fill_cells(&mut self) {
        let side = self.cells_per_side;
        let halves = if self.whole { 2 } else { 1 };
        let mut cells = Vec::with_capacity((halves * side * side) as usize);
        let mut from = 0;
        for row in 0..halves * side {
            let sign = if row < side { 1.0 } else { -1.0 };
            for step in 0..side {
                let column = if row % 2 == 0 { step } else { side - 1 - step };
                let at = |k: u32| (k as f32 + 0.5) / side as f32 * 2.0 - 1.0;
                let (p, q) = (at(column), at(row % side));
                let (x, y) = (0.5 * (p + q), 0.5 * (p - q));
                let local = Vec3::new(x, y, sign * (1.0 - x.abs() - y.abs())).normalize_or_zero();
                from = self.climb(self.local_from_world.inverse() * local, from);
                cells.push((row * side + column, from as u32));
            }
        }
        cells.sort_unstable();
        self.cells = cells.into_iter().map(|(_, node)| node).collect();
    }

    /// Walks from `start` to ever nearer neighbours. The grid's triangles are nearly equilateral, so there is no trap on
    /// the way.
    fn climb(&self, direction: Vec3, start: usize) -> usize {
        let mut best = start;
        let mut cosine = self.directions[best].dot(direction);
        loop {
            let here = best;
            for next in self.neighbours(here) {
                let c = self.directions[next].dot(direction);
                if c > cosine {
                    cosine = c;
                    best = next;
                }
            }
            if best == here {
                return best;
            }
        }
    }

    /// The node nearest to a unit direction from the centre; `None` where there are no nodes below the horizon and it lies
    /// below that by more than half their spacing.
    pub fn nearest(&self, direction: Vec3) -> Option<usize> {
        let local = self.local_from_world * direction;
        if local.is_nan() || !self.whole && local.z < self.lowest {
            return None;
        }
        let height = if self.whole {
            local.z.abs()
        } else {
            local.z.max(0.0)
        };
        let sum = local.x.abs() + local.y.abs() + height;
        let (x, y) = (local.x / sum, local.y / sum);
        let side = self.cells_per_side;
        let cell = |v: f32| (((v + 1.0) * 0.5 * side as f32) as u32).min(side - 1);
        let below = if self.whole && local.z < 0.0 { side } else { 0 };
        let start = self.cells[((below + cell(x - y)) * side + cell(x + y)) as usize];
        Some(self.climb(direction, start as usize))
    }

    /// The node nearest to where the ray from `position` along the unit `direction` meets the hemisphere: the nodes'
    /// sphere at finite radius, infinity otherwise.
    pub fn nearest_along(&self, position: Vec3, direction: Vec3) -> Option<usize> {
        self.nearest(self.from_centre(position, direction)?)
    }

    /// The unit direction from the centre to where the ray from `position` along the unit `direction` meets the hemisphere.
    pub fn from_centre(&self, position: Vec3, direction: Vec3) -> Option<Vec3> {
        let Some(radius) = self.radius else {
            return Some(direction);
        };
        let from = position - self.centre;
        let along = from.dot(direction);
        let discriminant = along * along - from.length_squared() + radius * radius;
        if discriminant < 0.0 {
            return None;
        }
        let distance = discriminant.sqrt() - along;
        (from + distance * direction).try_normalize()
    }

    /// The nodes that share a grid edge with `node`, ascending.
    pub fn neighbours(&self, node: usize) -> impl Iterator<Item = usize> {
        let range = self.neighbour_start[node] as usize..self.neighbour_start[node + 1] as usize;
        self.neighbour_list[range].iter().map(|&n| n as usize)
    }

    /// Mean angle between neighbours, in radians.
    pub fn spacing(&self) -> f32 {
        self.spacing
    }

    /// Unit direction from `position` to a node, and the factor on the node's solid angle there: 1 for distant light,
    /// (R / |p − x|)² at radius R, p the node.
    pub fn light_from(&self, node: usize, position: Vec3) -> (Vec3, f32) {
        let Some(radius) = self.radius else {
            return (self.directions[node], 1.0);
        };
        let to = self.centre + radius * self.directions[node] - position;
        // A surface that touches the hemisphere would be lit infinitely.
        let squared = to.length_squared().max(1e-4 * radius * radius);
        (to.normalize_or_zero(), radius * radius / squared)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Directions all over the sphere, evenly and irregularly.
    fn directions(count: usize) -> impl Iterator<Item = Vec3> {
        (0..count).map(move |i| {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
            let turn = i as f32 * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * turn.cos(), r * turn.sin(), z)
        })
    }

    fn ups() -> [Vec3; 5] {
        [
            Vec3::Z,
            Vec3::NEG_Z,
            Vec3::Y,
            Vec3::new(0.3, -2.0, 0.7),
            Vec3::new(-1.0, 1e-4, 0.0),
        ]
    }

    #[test]
    fn frequency_70_has_the_papers_nodes() {
        let grid = HemisphereGrid::new(70, Vec3::Y, None, Vec3::ZERO);
        assert_eq!(grid.directions.len(), 24_641);
    }

    #[test]
    fn solid_angles_fill_the_hemisphere() {
        for frequency in [1, 2, 7, 70] {
            let grid = HemisphereGrid::new(frequency, Vec3::X, None, Vec3::ZERO);
            let sum = f64::from(grid.solid_angle) * grid.directions.len() as f64;
            assert!(
                (sum - std::f64::consts::TAU).abs() < 1e-5,
                "frequency {frequency}: {sum}"
            );
        }
    }

    /// The cells of points of the sphere nearest to each node: none is far from the one solid angle that all nodes have.
    #[test]
    fn nodes_are_spread_evenly() {
        let grid = HemisphereGrid::new(20, Vec3::Z, None, Vec3::ZERO);
        let samples = 2_000_000;
        let mut hits = vec![0_u32; grid.directions.len()];
        for direction in directions(samples) {
            if let Some(node) = grid.nearest(direction) {
                hits[node] += 1;
            }
        }
        let expected = samples as f32 * grid.solid_angle / std::f32::consts::TAU / 2.0;
        let inside: Vec<f32> = (0..hits.len())
            .filter(|&i| grid.directions[i].z > 0.1)
            .map(|i| hits[i] as f32 / expected)
            .collect();
        let low = inside.iter().copied().fold(f32::INFINITY, f32::min);
        let high = inside.iter().copied().fold(0.0, f32::max);
        println!("cell areas {low} to {high} of the mean");
        assert!(low > 0.8 && high < 1.25, "{low} to {high}");
    }

    #[test]
    fn nearest_is_the_nearest_for_any_up() {
        for up in ups() {
            for frequency in [1, 3, 20] {
                let grid = HemisphereGrid::new(frequency, up, None, Vec3::ZERO);
                for direction in directions(3000) {
                    let brute = grid
                        .directions
                        .iter()
                        .map(|d| d.dot(direction))
                        .fold(f32::NEG_INFINITY, f32::max);
                    let elevation = direction.dot(grid.up).asin();
                    match grid.nearest(direction) {
                        Some(node) => assert!(
                            grid.directions[node].dot(direction) >= brute - 1e-6,
                            "{direction} found a farther node"
                        ),
                        None => assert!(
                            elevation < -0.49 * grid.spacing(),
                            "{direction} is above the horizon"
                        ),
                    }
                    if elevation < -0.51 * grid.spacing() {
                        assert!(
                            grid.nearest(direction).is_none(),
                            "{direction} is below the horizon"
                        );
                    }
                }
            }
        }
        let grid = HemisphereGrid::new(5, Vec3::Y, None, Vec3::ZERO);
        assert!(grid.nearest(Vec3::NAN).is_none());
    }

    #[test]
    fn every_node_is_its_own_nearest_and_lies_on_the_hemisphere() {
        for up in ups() {
            let grid = HemisphereGrid::new(33, up, None, Vec3::ZERO);
            for (i, &d) in grid.directions.iter().enumerate() {
                assert_eq!(grid.nearest(d), Some(i), "node {i}");
                assert!(
                    (d.length() - 1.0).abs() < 1e-6 && d.dot(grid.up) > -1e-6,
                    "node {i} at {d}"
                );
            }
        }
    }

    #[test]
    fn the_whole_sphere_goes_on_below_the_horizon() {
        for up in ups() {
            let above = HemisphereGrid::new(20, up, None, Vec3::ZERO);
            let whole = above.to_whole();
            let count = above.directions.len();
            assert_eq!(whole.directions[..count], above.directions);
            let all = whole.directions.len();
            assert!((2 * count - 90..2 * count).contains(&all), "{all}");
            let solid_angle = all as f32 * whole.solid_angle;
            assert!((solid_angle / (4.0 * std::f32::consts::PI) - 1.0).abs() < 1e-5);
            for (i, &d) in whole.directions.iter().enumerate() {
                assert_eq!(whole.nearest(d), Some(i), "node {i}");
                assert_eq!(i < count, d.dot(whole.up) > -1e-6, "node {i} at {d}");
                assert!(whole.neighbours(i).count() >= 5, "node {i}");
            }
            for direction in directions(2000) {
                let found = whole.directions[whole.nearest(direction).unwrap()].dot(direction);
                let nearer = whole
                    .directions
                    .iter()
                    .any(|d| d.dot(direction) > found + 1e-6);
                assert!(!nearer, "{direction} found a farther node");
            }
        }
    }

    #[test]
    fn neighbours_are_mutual_and_near() {
        let grid = HemisphereGrid::new(70, Vec3::Y, None, Vec3::ZERO);
        let mut with_six = 0;
        for i in 0..grid.directions.len() {
            let around: Vec<usize> = grid.neighbours(i).collect();
            assert!(
                around.len() <= 6 && around.len() >= 2,
                "node {i} has {}",
                around.len()
            );
            with_six += usize::from(around.len() == 6);
            for j in around {
                assert!(j != i && grid.neighbours(j).any(|k| k == i), "{i} and {j}");
                let angle = grid.directions[i].angle_between(grid.directions[j]);
                assert!(
                    angle > 0.7 * grid.spacing() && angle < 1.4 * grid.spacing(),
                    "{i} and {j}: {angle}"
                );
            }
        }
        assert!(with_six > 24_000, "{with_six} inner nodes");
    }

    #[test]
    fn at_finite_radius_light_has_parallax_and_falls_off() {
        let centre = Vec3::new(1.0, 2.0, 3.0);
        let grid = HemisphereGrid::new(10, Vec3::Y, Some(4.0), centre);
        for node in [0, 17, 200] {
            let x = centre + Vec3::new(0.5, -0.2, 0.3);
            let lamp = centre + 4.0 * grid.directions[node];
            let (direction, falloff) = grid.light_from(node, x);
            assert!(
                (direction - (lamp - x).normalize_or_zero()).length() < 1e-6,
                "node {node}"
            );
            let expected = 16.0 / (lamp - x).length_squared();
            assert!((falloff / expected - 1.0).abs() < 1e-5, "node {node}");
            assert_eq!(grid.nearest_along(x, direction), Some(node), "node {node}");
            let (_, at_centre) = grid.light_from(node, centre);
            assert!((at_centre - 1.0).abs() < 1e-6, "node {node}");
        }
        let distant = HemisphereGrid::new(10, Vec3::Y, None, centre);
        assert_eq!(
            distant.light_from(5, Vec3::ONE),
            (distant.directions[5], 1.0)
        );
    }
}
