//! Transmittance along single rays through the Gaussians, from any point in any direction, as the probes define it.
//!
//! The tree bounds, for each Gaussian, the region in which its alpha reaches 1/255. The alpha of a Gaussian on a ray is its
//! peak along the ray's line: the alpha of its footprint on the plane perpendicular to the ray, as in the probes.

use crate::cpu::attributes::AttributeSource;
use crate::cpu::occluder::{Occluder, Vec3, dot, occluders, plane_basis, widening};
use crate::{ProbeSettings, RayTree};
use relume_layout::constants::{MAX_OCCLUDER_VARIANCE, MIN_TRANSMITTANCE, TREE_DEPTH};

/// Maximum number of Gaussians per leaf.
const LEAF: usize = 4;

/// A bounding volume hierarchy over the Gaussians of a model, for transmittance along rays.
#[derive(Debug, Clone)]
pub struct OccluderBvh {
    /// Occluders in the order of the leaves.
    members: Vec<Occluder>,
    nodes: Vec<BvhNode>,
    settings: ProbeSettings,
}

/// A bounding box; its left child is the next node.
#[derive(Debug, Clone, Copy)]
struct BvhNode {
    low: Vec3,
    high: Vec3,
    /// First member of a leaf, or the right child.
    first: u32,
    /// Members of a leaf; 0 for inner nodes.
    count: u32,
}

/// An occluder with its bounding box.
struct BoundedOccluder {
    occluder: Occluder,
    half: Vec3,
}

impl OccluderBvh {
    /// Builds the tree over the Gaussians of `source`; `settings` determine which of them count for a ray.
    pub fn new(source: &AttributeSource<'_>, settings: ProbeSettings) -> Self {
        Self::of(occluders(source), settings)
    }

    /// The tree over `occluders`.
    pub(super) fn of(occluders: Vec<Occluder>, settings: ProbeSettings) -> Self {
        let mut boxes: Vec<BoundedOccluder> = occluders.into_iter().filter_map(boxed).collect();
        let mut nodes = Vec::with_capacity(2 * boxes.len() / LEAF + 1);
        if !boxes.is_empty() {
            build(&mut boxes, 0, &mut nodes);
        }
        Self { members: boxes.into_iter().map(|b| b.occluder).collect(), nodes, settings }
    }

    /// The tree in the layout of other engines.
    pub fn tree(&self) -> RayTree {
        let node = |n: &BvhNode| {
            let [a, b, c] = n.low.map(f32::to_bits);
            let [d, e, f] = n.high.map(f32::to_bits);
            [a, b, c, n.first, d, e, f, n.count]
        };
        let member = |o: &Occluder| {
            let [[a, b, c], [d, e, f], [g, h, i]] = o.axes;
            let [x, y, z] = o.mean;
            [x, y, z, o.opacity, a, b, c, o.reach, d, e, f, 0.0, g, h, i, 0.0]
        };
        RayTree {
            nodes: self.nodes.iter().map(node).collect(),
            members: self.members.iter().map(member).collect(),
            settings: self.settings,
        }
    }

    /// Share of light, 0 to 1, that reaches surface point `origin` from unit direction `d`.
    ///
    /// An occluder counts at distances from [`ProbeSettings::clearance`] of its own standard deviations plus
    /// [`ProbeSettings::bias`] up to [`ProbeSettings::reach`]. A transmittance below [`MIN_TRANSMITTANCE`] counts as 0.
    pub fn transmittance(&self, origin: Vec3, d: Vec3) -> f32 {
        self.transmittance_up_to(origin, d, self.settings.reach)
    }

    /// The same for occluders at distances up to `reach`, or up to [`ProbeSettings::reach`] if that is less.
    pub fn transmittance_up_to(&self, origin: Vec3, d: Vec3, reach: f32) -> f32 {
        let reach = reach.min(self.settings.reach);
        let (u, v) = plane_basis(d);
        let inverse = d.map(|x| 1.0 / x);
        let mut left = 1.0f32;
        let mut stack = [0u32; TREE_DEPTH];
        let mut height = usize::from(!self.nodes.is_empty());
        while height > 0 {
            height -= 1;
            let at = stack[height] as usize;
            let node = &self.nodes[at];
            if !node.is_hit(origin, inverse) {
                continue;
            }
            if node.count == 0 {
                stack[height] = node.first;
                stack[height + 1] = at as u32 + 1;
                height += 2;
                continue;
            }
            let first = node.first as usize;
            for o in &self.members[first..first + node.count as usize] {
                left *= 1.0 - self.alpha_on_ray(o, (origin, reach), [d, u, v]);
            }
            // Further occluders, in any order, only reduce the product.
            if left < MIN_TRANSMITTANCE {
                return 0.0;
            }
        }
        left
    }

    /// Alpha of one occluder on a ray.
    #[inline]
    fn alpha_on_ray(&self, o: &Occluder, (origin, reach): (Vec3, f32), [d, u, v]: [Vec3; 3]) -> f32 {
        let offset: Vec3 = std::array::from_fn(|k| o.mean[k] - origin[k]);
        let depth = dot(offset, d);
        // NaN fails the test as well.
        if !(depth >= self.settings.bias && depth <= reach) {
            return 0.0;
        }
        let Some(seen) = o.along(d, u, v) else { return 0.0 };
        if depth < self.settings.clearance * seen.thickness + self.settings.bias {
            return 0.0;
        }
        seen.alpha([dot(offset, u), dot(offset, v)]).unwrap_or(0.0)
    }
}

impl BvhNode {
    /// True when the ray from `origin` passes through the box; `inverse` is 1 / direction, per component.
    #[inline]
    fn is_hit(&self, origin: Vec3, inverse: Vec3) -> bool {
        let (mut enter, mut leave) = (0.0f32, f32::INFINITY);
        for k in 0..3 {
            let a = (self.low[k] - origin[k]) * inverse[k];
            let b = (self.high[k] - origin[k]) * inverse[k];
            // `max` and `min` ignore the NaN of a ray within a face: the other axes decide.
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        enter <= leave
    }
}

fn boxed(occluder: Occluder) -> Option<BoundedOccluder> {
    let variance: Vec3 = std::array::from_fn(|k| occluder.axes.iter().map(|a| a[k] * a[k]).sum());
    let floor = widening(variance.iter().sum());
    let half = variance.map(|s| (2.0 * occluder.reach * (s + floor)).sqrt());
    let usable = occluder.occludes() && variance.iter().all(|s| *s < MAX_OCCLUDER_VARIANCE);
    usable.then_some(BoundedOccluder { occluder, half })
}

/// Appends the tree over `boxes`, whose first element is member `first`, and sorts them into the order of its leaves.
fn build(boxes: &mut [BoundedOccluder], first: usize, nodes: &mut Vec<BvhNode>) {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let (mut least, mut most) = (low, high);
    for b in boxes.iter() {
        for k in 0..3 {
            let mean = b.occluder.mean[k];
            low[k] = low[k].min(mean - b.half[k]);
            high[k] = high[k].max(mean + b.half[k]);
            (least[k], most[k]) = (least[k].min(mean), most[k].max(mean));
        }
    }
    let at = nodes.len();
    if boxes.len() <= LEAF {
        nodes.push(BvhNode { low, high, first: first as u32, count: boxes.len() as u32 });
        return;
    }
    nodes.push(BvhNode { low, high, first: 0, count: 0 });
    let width = |k: usize| most[k] - least[k];
    let axis = (1..3).fold(0, |best, k| if width(k) > width(best) { k } else { best });
    let middle = boxes.len() / 2;
    boxes.select_nth_unstable_by(middle, |a, b| a.occluder.mean[axis].total_cmp(&b.occluder.mean[axis]));
    let (left, right) = boxes.split_at_mut(middle);
    build(left, first, nodes);
    nodes[at].first = nodes.len() as u32;
    build(right, first + middle, nodes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::project::project;
    use crate::cpu::{Probes, outward_normals};
    use crate::{RasterCamera, fibonacci_sphere};
    use glam::DVec3;
    use relume_compare::largest_difference;
    use relume_scene::{Camera, Field, Gaussians, ShadingOptions};

    /// A cloud of discs, needles and blobs of very different sizes, some almost transparent.
    fn cloud(n: usize) -> Gaussians {
        let mut g = Gaussians::zeroed(n, 1, 1, 0);
        let mut state = 9u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / 8_388_608.0 - 1.0
        };
        for (field, centre, spread) in [
            (Field::Mean, 0.0, 1.0),
            (Field::LogScale, -3.2, 1.4),
            (Field::Quaternion, 0.0, 1.0),
            (Field::OpacityLogit, 0.0, 6.0),
        ] {
            g.field_mut(field).iter_mut().for_each(|v| *v = centre + spread * noise());
        }
        g
    }

    fn source<'a>(g: &'a Gaussians, options: &'a ShadingOptions) -> AttributeSource<'a> {
        AttributeSource::new(g, &[[0.5; 3]], options)
    }

    #[test]
    fn ray_transmittance_equals_the_probe_measurement() {
        let (g, options) = (cloud(400), ShadingOptions::default());
        let source = source(&g, &options);
        // From the centres themselves, with the same clearance from a centre's own Gaussian as from the
        // others.
        let settings = ProbeSettings { offset: 0.0, ..ProbeSettings::default() };
        let directions = fibonacci_sphere(40);
        let probes = Probes::measure(&source, directions.clone(), settings);
        let members = occluders(&source);
        let normals = outward_normals(&source);
        let (mut expected, mut found) = (Vec::new(), Vec::new());
        for i in 0..g.len() {
            // A probe adds the deviation of its own Gaussian to the clearance.
            let own = members[i].axes.iter().map(|a| dot(*a, normals[i]).powi(2)).sum::<f32>().sqrt();
            let rays = OccluderBvh::new(&source, ProbeSettings { bias: settings.bias + own, ..settings });
            for (k, d) in directions.iter().enumerate() {
                expected.push(probes.transmittance[k][i]);
                found.push(rays.transmittance(g.get(Field::Mean, i), *d));
            }
        }
        let error = largest_difference(&found, &expected);
        assert!(error < 2e-3, "{error}");
        let hidden = expected.iter().filter(|t| **t < 0.5).count();
        assert!(hidden > 500, "the control: of 16,000 rays only {hidden} were hidden");
    }

    #[test]
    fn gaussians_without_a_photograph_block_light_and_are_not_drawn() {
        let (mut g, options) = (Gaussians::zeroed(1, 1, 0, 0), ShadingOptions::default());
        g.field_mut(Field::LogScale).fill(0.1f32.ln());
        g.field_mut(Field::Quaternion)[0] = 1.0;
        g.field_mut(Field::OpacityLogit).fill(20.0);
        let camera = Camera::look_at(DVec3::X * 3.0, DVec3::ZERO, DVec3::Z, 0.8, (16, 16)).unwrap();
        let view = RasterCamera::new(&camera, &options);
        for (rate, is_drawn) in [(8.0, true), (-8.0, false)] {
            g.field_mut(Field::SamplingRate)[0] = rate;
            let source = source(&g, &options);
            let rays = OccluderBvh::new(&source, ProbeSettings::default());
            assert!(rays.transmittance([0.0, 0.0, -1.0], [0.0, 0.0, 1.0]) < 0.02, "{rate}");
            assert_eq!(project(&view, 0, &source.geometry(0)).is_some(), is_drawn, "{rate}");
        }
    }

    #[test]
    fn reach_and_clearance_limit_the_occluders() {
        let (mut g, options) = (Gaussians::zeroed(1, 1, 0, 0), ShadingOptions::default());
        g.row_mut(Field::Mean, 0).copy_from_slice(&[0.0, 0.0, 1.0]);
        g.field_mut(Field::LogScale).fill(0.1f32.ln());
        g.field_mut(Field::Quaternion)[0] = 1.0;
        g.field_mut(Field::OpacityLogit).fill(20.0);
        let source = source(&g, &options);
        let through = |settings: ProbeSettings, origin: Vec3, d: Vec3| {
            OccluderBvh::new(&source, settings).transmittance(origin, d)
        };
        let usual = ProbeSettings::default();
        assert!((through(usual, [0.0; 3], [0.0, 0.0, 1.0]) - 0.01).abs() < 1e-4, "alpha ends at 0.99");
        assert_eq!(through(usual, [0.0; 3], [0.0, 0.0, -1.0]), 1.0);
        assert_eq!(through(usual, [0.0, 0.0, 0.78], [0.0, 0.0, 1.0]), 1.0, "two deviations and 0.03 away");
        assert!(through(usual, [0.0, 0.0, 0.76], [0.0, 0.0, 1.0]) < 0.02);
        assert_eq!(through(ProbeSettings { reach: 0.5, ..usual }, [0.0; 3], [0.0, 0.0, 1.0]), 1.0);
        let half = through(usual, [0.1 * (2.0 * 2.0f32.ln()).sqrt(), 0.0, 0.0], [0.0, 0.0, 1.0]);
        assert!((half - 0.5).abs() < 1e-3, "{half}");
        assert_eq!(OccluderBvh::new(&source, usual).transmittance([f32::NAN; 3], [0.0, 0.0, 1.0]), 1.0);
        let empty = Gaussians::zeroed(0, 1, 0, 0);
        let nothing = AttributeSource { gaussians: &empty, ..source };
        assert_eq!(OccluderBvh::new(&nothing, usual).transmittance([0.0; 3], [0.0, 0.0, 1.0]), 1.0);
    }
}
