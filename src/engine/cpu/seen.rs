//! Which splats a picture shows: of a solid thing most lie behind others.

use rayon::prelude::*;

use crate::engine::constants::EarlyStop;
use crate::engine::cpu::blend::{BlendScratch, TileJob, mark_seen};
use crate::engine::cpu::project::Splat;
use crate::engine::cpu::tiles::TileLists;

/// True for every splat that blending takes something of in some pixel; the others may have any attributes.
pub(super) fn seen(splats: &[Splat], tiles: &TileLists, early_stop: EarlyStop) -> Vec<bool> {
    let mut in_slot = vec![false; tiles.splat_of_slot.len()];
    let mut parts = Vec::with_capacity(tiles.len());
    let mut rest = in_slot.as_mut_slice();
    for tile in 0..tiles.len() {
        let (part, tail) = rest.split_at_mut(tiles.slots(tile).len());
        parts.push(part);
        rest = tail;
    }
    parts.into_par_iter().enumerate().for_each_init(BlendScratch::default, |scratch, (tile, marks)| {
        let (members, origin) = (tiles.members(tile), tiles.origin(tile));
        if !members.is_empty() {
            let job = TileJob { splats, members, attributes: &[], stored: 0, origin, early_stop };
            mark_seen(&job, scratch, marks);
        }
    });
    let is_seen = |splat| tiles.slots_of_splat(splat).iter().any(|slot| in_slot[*slot as usize]);
    (0..splats.len()).into_par_iter().with_min_len(1024).map(is_seen).collect()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::engine::channel::{Channels, RowLight};
    use crate::engine::cpu::attributes::AttributeSource;
    use crate::engine::cpu::pass::{Pass, project_all};
    use crate::engine::{NO_INDIRECT_BASIS, RasterCamera};
    use crate::scene::{Camera, Field, Gaussians, ShadingOptions};

    #[test]
    fn attributes_of_what_is_not_seen_do_not_matter_and_those_of_the_rest_do() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut gaussians = Gaussians::zeroed(3000, 1, 0, 0);
        gaussians.field_mut(Field::Mean).iter_mut().for_each(|v| *v = rng.random_range(-0.5..0.5));
        gaussians.field_mut(Field::LogScale).fill(-1.9);
        gaussians.field_mut(Field::Quaternion).iter_mut().step_by(4).for_each(|v| *v = 1.0);
        gaussians.field_mut(Field::OpacityLogit).fill(5.0);
        let options = ShadingOptions::default();
        let source = AttributeSource {
            gaussians: &gaussians,
            prototypes: &[[0.5; 3]],
            options: &options,
            gathered: &[],
            arriving: &[],
            indirect_basis: &NO_INDIRECT_BASIS,
            light: None,
        };
        let camera =
            Camera::look_at(DVec3::new(0.3, -2.0, 0.4), DVec3::ZERO, DVec3::Z, 0.6, (50, 40)).unwrap();
        let view = RasterCamera::new(&camera, &options);
        let splats = project_all(&source, &view);
        let tiles = TileLists::new(view.width, view.height, &splats);
        let seen = seen(&splats, &tiles, EarlyStop::WhenSaturated);
        let hidden = seen.iter().filter(|seen| !**seen).count();
        assert!(hidden > 100 && hidden + 100 < splats.len(), "{hidden} of {} hidden", splats.len());
        let stored = Channels::Colour.stored();
        let picture = |is_blank: &dyn Fn(usize) -> bool| {
            let row =
                |i: usize| [1.0, 0.1 * (i % 7) as f32, 0.2, 0.3].map(|v| if is_blank(i) { 0.0 } else { v });
            let attributes: Vec<f32> = (0..splats.len()).flat_map(row).collect();
            assert_eq!(attributes.len(), splats.len() * stored);
            let binned = (splats.clone(), tiles.clone());
            let stop = EarlyStop::WhenSaturated;
            Pass::blend(view, binned, Channels::Colour, RowLight::Outgoing, attributes, stop).gbuffer
        };
        let whole = picture(&|_| false);
        assert!(whole == picture(&|i| !seen[i]));
        let nearest = seen.iter().position(|seen| *seen).unwrap();
        assert!(whole != picture(&|i| i == nearest), "the control");
    }
}
