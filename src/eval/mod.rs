//! Metrics against ground truth, reports and contact sheets.
//!
//! The main protocol is TensoIR's (whole image on white, no mask, sRGB curve, no scaling of pictures); what it
//! is exactly travels with every report as [`Report::protocol`].

mod attribution;
mod contact;
mod conv;
mod evaluate;
mod font;
mod image;
mod layers;
mod lpips;
mod report;
pub mod sheet;
mod totals;
mod views;

pub use attribution::{Replaced, attribute};
pub use contact::{contact_sheet, truth_layers};
pub use evaluate::{EvalError, EvalOptions, evaluate};
#[cfg(feature = "cli")]
pub(crate) use evaluate::{evenly_spaced, lights_of};
pub use image::{PSNR_CAP, Picture, mean_squared_error, psnr, psnr_of, ssim};
pub use layers::{NormalErrors, RatioMedian, normal_errors};
pub use lpips::{Lpips, LpipsError};
pub use report::{AlbedoScores, ImageScores, NormalScores, RelitScores, Report};
#[cfg(feature = "cli")]
pub(crate) use views::on_white;
pub use views::photograph;
