//! Plots measurements as one SVG with logarithmic axes.

use std::ops::Range;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::cli::error::CommandResult;

/// Width and height of a panel, pixels.
const PANEL: (u32, u32) = (420, 340);
const COLOURS: [RGBColor; 6] = [
    RGBColor(27, 108, 168),
    RGBColor(209, 73, 91),
    RGBColor(60, 141, 83),
    RGBColor(141, 90, 151),
    RGBColor(199, 127, 27),
    RGBColor(85, 85, 85),
];
const FONT: (&str, u32) = ("sans-serif", 12);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Points of one colour.
pub(super) struct Series {
    pub(super) name: String,
    /// Number of leading points that are not joined by a line.
    pub(super) unjoined: usize,
    /// Abscissa, ordinate and label of each point.
    pub(super) points: Vec<(f64, f64, String)>,
}

/// One chart of the figure.
pub(super) struct Panel {
    pub(super) title: &'static str,
    pub(super) x_label: &'static str,
    pub(super) y_label: &'static str,
    pub(super) series: Vec<Series>,
}

/// The panels that have points, side by side.
pub(super) fn svg(mut panels: Vec<Panel>) -> CommandResult<String> {
    panels.retain(|panel| panel.series.iter().any(|s| !s.points.is_empty()));
    let mut out = String::new();
    let size = (PANEL.0 * panels.len() as u32, PANEL.1);
    let figure = SVGBackend::with_string(&mut out, size).into_drawing_area();
    figure.fill(&WHITE)?;
    for (area, panel) in figure.split_evenly((1, panels.len())).iter().zip(&panels) {
        panel.draw(area)?;
    }
    figure.present()?;
    drop(figure);
    Ok(out)
}

/// From half the minimum to twice the maximum of the positive finite values.
fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let usable = values.filter(|v| *v > 0.0 && v.is_finite());
    let (low, high) = usable.fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
    if high > 0.0 { low / 2.0..high * 2.0 } else { 0.1..1.0 }
}

/// Multiples 1, 2 and 5 of powers of ten. The ticks of plotters omit those below the first power of ten.
fn ticks(range: &Range<f64>) -> Vec<f64> {
    let (first, last) = (range.start.log10().floor() as i32, range.end.log10().ceil() as i32);
    let all = (first..=last).flat_map(|e| [1, 2, 5].map(|m| format!("{m}e{e}").parse().unwrap_or_default()));
    all.filter(|v| range.contains(v)).collect()
}

impl Panel {
    fn draw(&self, area: &Area<'_>) -> CommandResult {
        let points = || self.series.iter().flat_map(|s| &s.points);
        let (x, y) = (range(points().map(|p| p.0)), range(points().map(|p| p.1)));
        let mut area = area.titled(self.title, ("sans-serif", 15).into_font().style(FontStyle::Bold))?;
        let coloured = || self.series.iter().zip(COLOURS.iter().cycle());
        for (series, colour) in coloured() {
            area = area.titled(&series.name, FONT.into_font().color(colour))?;
        }
        let mut chart = ChartBuilder::on(&area)
            .margin(10)
            .margin_right(20)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(
                x.clone().log_scale().with_key_points(ticks(&x)),
                y.clone().log_scale().with_key_points(ticks(&y)),
            )?;
        let size = area.dim_in_pixel();
        let plain = |v: &f64| v.to_string();
        chart
            .configure_mesh()
            .max_light_lines(0)
            .x_desc(self.x_label)
            .y_desc(self.y_label)
            .x_label_formatter(&plain)
            .y_label_formatter(&plain)
            .label_style(FONT)
            .draw()?;
        for (series, colour) in coloured() {
            let joined = series.points.iter().skip(series.unjoined).map(|p| (p.0, p.1));
            chart.draw_series(LineSeries::new(joined, colour))?;
            chart.draw_series(series.points.iter().map(|p| Circle::new((p.0, p.1), 3, colour.filled())))?;
        }
        // Only the points of the first series are labelled; the other series have the same order.
        if let Some(series) = self.series.first() {
            chart.draw_series(series.points.iter().enumerate().map(|(k, (x, y, label))| {
                // Labels are to the lower left of a line. Single points are close together, so their labels are stacked.
                let (side, offset) = match k {
                    k if k < series.unjoined => (HPos::Left, (6, 13 * k as i32 - 12)),
                    _ => (HPos::Right, (-6, 4)),
                };
                let style = FONT.into_font().into_text_style(&size).pos(Pos::new(side, VPos::Top));
                EmptyElement::at((*x, *y)) + Text::new(label.clone(), offset, style)
            }))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_axis_ticks_are_one_two_and_five_times_powers_of_ten() {
        assert_eq!(ticks(&(0.015..1.5)), [0.02, 0.05, 0.1, 0.2, 0.5, 1.0]);
        assert_eq!(range([0.0, f64::NAN].into_iter()), 0.1..1.0, "no positive finite value");
    }
}
