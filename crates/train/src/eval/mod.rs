//! Metrics against ground truth, reports and contact sheets.
//!
//! The main protocol is that of TensoIR: whole image on white, no mask, sRGB curve, no scaling of images.
//! [`Report::protocol`] states it completely in every report.

mod attribution;
mod cell;
mod confidence;
mod contact;
mod conv;
mod coverage;
mod delit_albedo;
mod evaluate;
mod exposure;
mod image;
mod layers;
mod lpips;
mod novel_views;
mod pose_error;
mod report;
mod sheet;
mod sheet_rows;
mod summary;
mod text;
mod totals;
mod views;

pub use attribution::{TruthLayer, attribute};
pub use cell::CELL;
pub use confidence::{ConfidenceScore, ConfidenceScores, confidence_scores};
pub use contact::contact_sheet;
pub use delit_albedo::{DelitAlbedoScores, delit_albedo_scores};
pub use evaluate::{EvalError, EvalOptions, evaluate};
pub use evaluate::{evenly_spaced, lights_of};
pub use image::{DisplayImage, PSNR_CAP, mean_squared_error, psnr, psnr_of, ssim};
pub use layers::{NormalErrors, RatioMedian, normal_errors};
pub use lpips::{Lpips, LpipsError};
pub use novel_views::{NovelViewScores, NovelViews};
pub use pose_error::PoseErrors;
pub use report::figure;
pub use report::{AlbedoScores, ImageScores, NormalScores, RelitScores, Report, ViewScore};
pub use sheet::{Column, Sheet, SheetFormat};
pub use sheet_rows::SheetRows;
pub use summary::CaptureFacts;
pub(crate) use views::light_of;
pub use views::on_white;
pub use views::photograph;
