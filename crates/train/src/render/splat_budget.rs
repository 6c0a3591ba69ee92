//! Exports with a limited number of Gaussians or bytes.

use std::sync::Arc;

use crate::render::SplatFileError;
use crate::render::pruned::{Contributions, PrunedModel};
use relume_scene::Model;

/// Attempts to meet a limit of bytes. Files are almost linear in the number of Gaussians, so the second one succeeds.
const ATTEMPTS: usize = 8;

/// Limits of an export.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SplatBudget {
    /// Greatest number of Gaussians.
    pub splats: Option<u32>,
    /// Greatest size of the file, bytes.
    pub bytes: Option<u64>,
}

/// A file within a budget.
#[derive(Debug, Clone, PartialEq)]
pub struct BudgetedFile {
    /// The file.
    pub bytes: Vec<u8>,
    /// Number of Gaussians of the model before the pruning.
    pub all: usize,
    /// The number of Gaussians in it, and the PSNR of its colours against those of the whole model, dB; `None` if no Gaussian was removed.
    pub pruned: Option<(usize, f64)>,
}

impl SplatBudget {
    /// Encodes a checked model with as many Gaussians as the budget allows: those that contribute most to views around the model. Stops early
    /// once `is_wanted` returns false.
    ///
    /// # Errors
    /// The error of `encode`; [`SplatFileError::Budget`] if the limit of bytes is too small for one Gaussian; [`Abandoned`](crate::render::RenderError::Abandoned) if
    /// the file is not wanted.
    pub fn encode(
        self,
        model: Model,
        encode: impl Fn(&Model) -> Result<Vec<u8>, SplatFileError>,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<BudgetedFile, SplatFileError> {
        let all = model.gaussians.len();
        let most = self.splats.map_or(all, |splats| (splats as usize).min(all));
        let limit = self.bytes.unwrap_or(u64::MAX);
        let size = {
            let bytes = encode(&model)?;
            if most == all && bytes.len() as u64 <= limit {
                return Ok(BudgetedFile { bytes, all, pruned: None });
            }
            bytes.len()
        };
        let contributions = Contributions::of(Arc::new(model), is_wanted)?;
        let mut number = most.min(scaled(all, limit, size)).max(1);
        for _ in 0..ATTEMPTS {
            let kept = contributions.kept(number);
            let size = encode(&kept)?.len();
            if size as u64 <= limit {
                let PrunedModel { model, psnr_db } = contributions.widened(&kept, is_wanted)?;
                // A file of text has a few bytes more or less for other numbers.
                let bytes = encode(&model)?;
                if bytes.len() as u64 <= limit {
                    return Ok(BudgetedFile { bytes, all, pruned: Some((number, psnr_db)) });
                }
            }
            if number == 1 {
                break;
            }
            number = scaled(number, limit, size).min(number - 1).max(1);
        }
        Err(SplatFileError::Budget { limit })
    }
}

/// The number of Gaussians that fit into `limit` bytes if `of` take `bytes`.
fn scaled(of: usize, limit: u64, bytes: usize) -> usize {
    let share = (limit as f64 / bytes.max(1) as f64).min(1.0);
    (of as f64 * share) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::{Field, Gaussians};

    /// A row of balls from large to small.
    fn model() -> Model {
        let mut g = Gaussians::zeroed(6, 1, 0, 0);
        for i in 0..6 {
            g.row_mut(Field::Mean, i)[1] = 0.3 * i as f32 - 0.75;
            g.row_mut(Field::LogScale, i).fill((0.12 - 0.02 * i as f32).ln());
            g.row_mut(Field::Quaternion, i)[0] = 1.0;
            g.row_mut(Field::OpacityLogit, i)[0] = 4.0;
            g.row_mut(Field::Radiance, i).fill(0.2 * i as f32);
        }
        Model::new(g, vec![[0.5; 3]], vec![[0.5; 3]; 8], (4, 2))
    }

    /// A file of 10 bytes and 7 bytes for each Gaussian.
    fn file(model: &Model) -> Result<Vec<u8>, SplatFileError> {
        Ok(vec![0; 10 + 7 * model.gaussians.len()])
    }

    #[test]
    fn largest_gaussians_remain_in_their_order() {
        let kept = std::cell::RefCell::new(Vec::new());
        let encode = |model: &Model| {
            *kept.borrow_mut() = model.gaussians.field(Field::Mean).to_vec();
            file(model)
        };
        let budget = SplatBudget { splats: Some(2), bytes: None };
        let made = budget.encode(model(), encode, &|| true).unwrap();
        let (number, psnr) = made.pruned.unwrap();
        assert!(number == 2 && made.all == 6 && psnr > 15.0 && psnr < 60.0, "{psnr}");
        assert_eq!(kept.borrow()[..], model().gaussians.field(Field::Mean)[..6]);
    }

    #[test]
    fn more_gaussians_are_closer_to_the_model() {
        let of = |splats| {
            let made =
                SplatBudget { splats: Some(splats), bytes: None }.encode(model(), file, &|| true).unwrap();
            made.pruned.map(|(_, psnr)| psnr)
        };
        let [few, most, all] = [2, 5, 6].map(of);
        assert!(few.unwrap() + 1.0 < most.unwrap(), "{few:?} {most:?}");
        assert_eq!(all, None);
    }

    #[test]
    fn file_is_as_large_as_its_limit_allows() {
        let of = |bytes| SplatBudget { splats: None, bytes: Some(bytes) }.encode(model(), file, &|| true);
        assert_eq!(of(52).unwrap().pruned, None);
        let made = of(38).unwrap();
        assert_eq!((made.bytes.len(), made.pruned.map(|(number, _)| number)), (38, Some(4)));
        assert!(matches!(of(16), Err(SplatFileError::Budget { limit: 16 })));
        let budget = SplatBudget { splats: Some(2), bytes: None };
        assert!(budget.encode(model(), file, &|| false).is_err(), "nobody waits for it");
    }
}
