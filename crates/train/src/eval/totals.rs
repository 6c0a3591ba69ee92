//! Running means over views.

use crate::eval::image::{DisplayImage, psnr, ssim};
use crate::eval::layers::{RatioMedian, albedo_psnr, masked_mae, normal_errors};
use crate::eval::lpips::Lpips;
use crate::eval::report::{ImageScores, Report};
use crate::eval::views::{ViewLayers, foreground};
use relume_capture::CaptureView;

/// A mean of the values that are present.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Mean {
    sum: f64,
    count: usize,
}

impl Mean {
    pub(crate) fn add(&mut self, value: Option<f64>) {
        if let Some(value) = value {
            self.sum += value;
            self.count += 1;
        }
    }

    pub(crate) fn value(self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

/// Image metrics over views.
#[derive(Default)]
pub(crate) struct ImageTotals {
    psnr: Mean,
    ssim: Mean,
    lpips: Mean,
}

impl ImageTotals {
    pub(crate) fn add(&mut self, predicted: &DisplayImage, truth: &DisplayImage, lpips: Option<&Lpips>) {
        self.psnr.add(Some(psnr(predicted, truth)));
        self.ssim.add(ssim(predicted, truth));
        self.lpips.add(lpips.and_then(|metric| metric.distance(predicted, truth)));
    }

    pub(crate) fn scores(&self) -> ImageScores {
        ImageScores { psnr: self.psnr.value(), ssim: self.ssim.value(), lpips: self.lpips.value() }
    }
}

/// Layer metrics over views.
#[derive(Default)]
pub(crate) struct LayerTotals {
    albedo: Mean,
    albedo_foreground: Mean,
    ratios: RatioMedian,
    normal_foreground: Mean,
    normal_all: Mean,
    visibility: Mean,
    roughness: Mean,
    metallic: Mean,
    depth: Mean,
}

impl LayerTotals {
    /// Compares one view's layers with the ground truth that the view has.
    pub(crate) fn add(&mut self, layers: &ViewLayers, view: &CaptureView) {
        let (truth, mask) = (&view.truth, foreground(&view.image));
        if let Some(albedo) = &truth.albedo {
            let [whole, inside] = albedo_psnr((&layers.albedo, &layers.alpha), albedo, &view.image);
            self.albedo.add(whole);
            self.albedo_foreground.add(inside);
            self.ratios.add(&layers.albedo, &albedo.values, &mask);
        }
        if let Some(normal) = &truth.normal {
            let alpha = view.image.alpha();
            let errors = normal_errors((&layers.normal, &layers.alpha), (&normal.values, &alpha), &mask);
            self.normal_foreground.add(errors.map(|e| e.foreground));
            self.normal_all.add(errors.map(|e| e.all_pixels));
        }
        if let Some(open) = &truth.ambient_occlusion {
            self.visibility.add(masked_mae(&layers.visibility, open.values.iter().map(|v| v[0]), &mask));
        }
        if let Some(material) = &truth.metallic_roughness {
            self.metallic.add(masked_mae(&layers.metallic, material.values.iter().map(|v| v[0]), &mask));
            self.roughness.add(masked_mae(&layers.roughness, material.values.iter().map(|v| v[1]), &mask));
        }
        if let Some(depth) = &truth.depth {
            // Depth without a surface is 0 in the ground truth and infinity in the prediction.
            let pairs = depth.values.iter().zip(&layers.depth);
            let known = pairs.zip(&mask).map(|((t, p), m)| *m && t[0] > 0.0 && !p.is_infinite());
            let known: Vec<bool> = known.collect();
            self.depth.add(masked_mae(&layers.depth, depth.values.iter().map(|v| v[0]), &known));
        }
    }

    /// Writes the means to the report.
    pub(crate) fn write(self, report: &mut Report) {
        report.albedo.psnr_raw = self.albedo.value();
        report.albedo.psnr_raw_foreground = self.albedo_foreground.value();
        report.albedo.scale = self.ratios.median();
        report.normal_mae_deg.foreground = self.normal_foreground.value();
        report.normal_mae_deg.all_pixels = self.normal_all.value();
        report.ao_mae = self.visibility.value();
        report.roughness_mae = self.roughness.value();
        report.metallic_mae = self.metallic.value();
        report.depth_mae = self.depth.value();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_ignores_missing_values_and_is_none_without_values() {
        let mut mean = Mean::default();
        mean.add(None);
        assert_eq!(mean.value(), None);
        mean.add(Some(1.0));
        mean.add(None);
        mean.add(Some(2.0));
        assert_eq!(mean.value(), Some(1.5));
    }
}
