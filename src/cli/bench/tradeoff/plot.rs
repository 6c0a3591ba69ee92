//! The figures as one SVG of three panels with logarithmic axes.

use std::fmt::Write as _;

use super::Row;
use super::report::{slopes, tier_name};
use crate::render::Tier;

const WIDTH: f64 = 420.0;
const HEIGHT: f64 = 340.0;
/// Left, top, right, bottom of a panel's axes inside it; the legend's lines come on top of the top.
const MARGIN: [f64; 4] = [64.0, 36.0, 16.0, 52.0];
/// Of a line of text, and of a letter as wide as most.
const LINE: f64 = 14.0;
const LETTER: f64 = 6.2;
const COLOURS: [&str; 6] = ["#1b6ca8", "#d1495b", "#3c8d53", "#8d5a97", "#c77f1b", "#555555"];

/// Points of one colour, joined in their order.
struct Series {
    name: String,
    /// Leading points that stand by themselves.
    alone: usize,
    /// Abscissa, ordinate and what is written beside the point.
    points: Vec<(f64, f64, String)>,
}

/// A panel of the figure.
struct Panel {
    title: &'static str,
    across: &'static str,
    up: &'static str,
    series: Vec<Series>,
}

pub(super) fn svg(rows: &[Row]) -> Result<String, std::fmt::Error> {
    let panels = [time_against_error(rows), samples_against_error(rows), training_against_truth(rows)];
    let shown: Vec<&Panel> =
        panels.iter().filter(|p| p.series.iter().any(|s| !s.points.is_empty())).collect();
    let width = WIDTH * shown.len() as f64;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {HEIGHT}\" width=\"{width}\" height=\"{HEIGHT}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for (i, panel) in shown.iter().enumerate() {
        writeln!(out, "<g transform=\"translate({} 0)\">", i as f64 * WIDTH)?;
        panel.draw(&mut out)?;
        writeln!(out, "</g>")?;
    }
    writeln!(out, "</svg>")?;
    Ok(out)
}

fn groups(rows: &[Row]) -> Vec<(&str, &str)> {
    let mut all: Vec<(&str, &str)> = rows.iter().map(|r| (r.model.as_str(), r.device.as_str())).collect();
    all.dedup();
    all
}

fn time_against_error(rows: &[Row]) -> Panel {
    let series = groups(rows).into_iter().map(|(model, device)| {
        let own = || rows.iter().filter(|r| (r.model.as_str(), r.device.as_str()) == (model, device));
        Series {
            name: format!("{model}, {device}"),
            // Samples of the reference tier make a line, tiers do not.
            alone: own().take_while(|r| r.quality.tier != Tier::MonteCarlo).count(),
            points: own().map(|r| (r.frame_ms, r.shown, tier_name(r))).collect(),
        }
    });
    Panel {
        title: "Tiers: time against error",
        across: "milliseconds a frame",
        up: "error against reference (shown)",
        series: series.collect(),
    }
}

fn samples_against_error(rows: &[Row]) -> Panel {
    let series = slopes(rows).into_iter().map(|(model, slope)| {
        let own = rows.iter().filter(|r| r.model == model && r.quality.tier == Tier::MonteCarlo);
        let points = own.map(|r| (f64::from(r.quality.samples), r.linear, String::new())).collect();
        Series { name: format!("{model}: slope {slope:.2}"), alone: 0, points }
    });
    Panel {
        title: "Reference: samples against error",
        across: "samples a pixel",
        up: "error (linear)",
        series: series.collect(),
    }
}

fn training_against_truth(rows: &[Row]) -> Panel {
    let series = [Tier::Standard, Tier::High].map(|tier| {
        let own = rows.iter().filter(|r| r.quality.tier == tier && r.device == "cpu");
        let points = own.filter_map(|r| Some((r.training_seconds?, r.truth?, r.preset.clone())));
        Series { name: format!("rendered with {}", tier.name()), alone: 0, points: points.collect() }
    });
    Panel {
        title: "Training: time against truth",
        across: "seconds of training",
        up: "error against ground truth (shown)",
        series: series.into(),
    }
}

/// A logarithmic axis between two powers of ten or halves of one.
struct Axis {
    low: f64,
    high: f64,
    /// Pixels of its ends.
    ends: [f64; 2],
}

impl Axis {
    fn new(values: impl Iterator<Item = f64>, ends: [f64; 2]) -> Self {
        let usable = values.filter(|v| *v > 0.0 && v.is_finite());
        let (low, high) = usable.fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
        if high <= 0.0 {
            return Self { low: 0.1, high: 1.0, ends };
        }
        Self { low: low / 1.5, high: high * 1.5, ends }
    }

    fn at(&self, value: f64) -> f64 {
        let share = (value.max(1e-300) / self.low).ln() / (self.high / self.low).ln();
        self.ends[0] + share.clamp(0.0, 1.0) * (self.ends[1] - self.ends[0])
    }

    /// 1, 2 and 5 times powers of ten.
    fn ticks(&self) -> Vec<f64> {
        let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
        let all = (first..=last).flat_map(|e| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(e)));
        all.filter(|v| (self.low..=self.high).contains(v)).collect()
    }
}

impl Panel {
    fn draw(&self, out: &mut String) -> std::fmt::Result {
        let [left, top, right, bottom] = MARGIN;
        let points = || self.series.iter().flat_map(|s| &s.points);
        let x = Axis::new(points().map(|p| p.0), [left, WIDTH - right]);
        let legend = LINE * self.series.len() as f64;
        let y = Axis::new(points().map(|p| p.1), [HEIGHT - bottom, top + legend]);
        writeln!(
            out,
            "<text x=\"{left}\" y=\"20\" font-size=\"13\" font-weight=\"bold\">{}</text>",
            self.title
        )?;
        for tick in x.ticks() {
            let at = x.at(tick);
            writeln!(out, "<path d=\"M{at:.1} {:.1}V{:.1}\" stroke=\"#dddddd\"/>", y.ends[0], y.ends[1])?;
            writeln!(
                out,
                "<text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{tick}</text>",
                y.ends[0] + 14.0
            )?;
        }
        for tick in y.ticks() {
            let (at, label) = (y.at(tick), format!("{tick:.6}"));
            let label = label.trim_end_matches('0').trim_end_matches('.');
            writeln!(out, "<path d=\"M{:.1} {at:.1}H{:.1}\" stroke=\"#dddddd\"/>", x.ends[0], x.ends[1])?;
            writeln!(
                out,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
                left - 4.0,
                at + 4.0
            )?;
        }
        let middle = |axis: &Axis| 0.5 * (axis.ends[0] + axis.ends[1]);
        writeln!(
            out,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            middle(&x),
            HEIGHT - 12.0,
            self.across
        )?;
        let up = middle(&y);
        writeln!(
            out,
            "<text transform=\"translate(14 {up:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            self.up
        )?;
        let mut labels = Labels { right: WIDTH - right, taken: Vec::new() };
        for (i, series) in self.series.iter().enumerate() {
            series.draw(out, (&x, &y), i, &mut labels)?;
        }
        Ok(())
    }
}

/// Where there is text already.
struct Labels {
    /// No text goes beyond.
    right: f64,
    /// Left, top, right, bottom.
    taken: Vec<[f64; 4]>,
}

impl Labels {
    /// Left end and baseline of a text beside a point: where it covers no other, else above to the right.
    fn place(&mut self, (x, y): (f64, f64), text: &str) -> (f64, f64) {
        let width = LETTER * text.chars().count() as f64;
        let places =
            [(5.0, -5.0), (5.0, 13.0), (-5.0 - width, -5.0), (-5.0 - width, 13.0), (5.0, 26.0), (5.0, -18.0)];
        let around = |(dx, dy): (f64, f64)| [x + dx, y + dy - 10.0, x + dx + width, y + dy + 2.0];
        let is_free = |b: &[f64; 4]| {
            let clear = |t: &[f64; 4]| b[0] > t[2] || t[0] > b[2] || b[1] > t[3] || t[1] > b[3];
            b[2] <= self.right && self.taken.iter().all(clear)
        };
        let (dx, dy) = places.into_iter().find(|place| is_free(&around(*place))).unwrap_or(places[0]);
        self.taken.push(around((dx, dy)));
        (x + dx, y + dy)
    }
}

impl Series {
    fn draw(
        &self,
        out: &mut String,
        (x, y): (&Axis, &Axis),
        index: usize,
        labels: &mut Labels,
    ) -> std::fmt::Result {
        let colour = COLOURS[index % COLOURS.len()];
        let at: Vec<(f64, f64)> = self.points.iter().map(|p| (x.at(p.0), y.at(p.1))).collect();
        let line: Vec<String> = at.iter().skip(self.alone).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        writeln!(out, "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\"/>", line.join(" "))?;
        for ((px, py), (_, _, label)) in at.iter().zip(&self.points) {
            writeln!(out, "<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"3\" fill=\"{colour}\"/>")?;
            // One series names its points; those of the others are in the same order.
            if index == 0 && !label.is_empty() {
                let (lx, ly) = labels.place((*px, *py), label);
                let label = escaped(label);
                writeln!(out, "<text x=\"{lx:.1}\" y=\"{ly:.1}\" fill=\"#333333\">{label}</text>")?;
            }
        }
        let height = MARGIN[1] + LINE * index as f64;
        let name = escaped(&self.name);
        writeln!(out, "<text x=\"{:.1}\" y=\"{height:.1}\" fill=\"{colour}\">{name}</text>", x.ends[0])
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_spreads_decades_evenly_and_labels_what_lies_on_it() {
        let axis = Axis::new([1.5, 1500.0].into_iter(), [0.0, 300.0]);
        assert!((axis.at(47.4) - axis.at(4.74) - (axis.at(474.0) - axis.at(47.4))).abs() < 1e-6);
        assert_eq!(axis.ticks()[..3], [1.0, 2.0, 5.0]);
        assert!(axis.ticks().len() == 11 && axis.at(0.0) == 0.0 && axis.at(1e9) == 300.0);
        assert!(!Axis::new(std::iter::empty(), [0.0, 1.0]).ticks().is_empty());
        assert_eq!(escaped("a<b&c"), "a&lt;b&amp;c");
    }

    #[test]
    fn labels_keep_off_one_another_and_inside() {
        let mut labels = Labels { right: 400.0, taken: Vec::new() };
        let first = labels.place((100.0, 100.0), "standard");
        assert_eq!(first, (105.0, 95.0));
        assert_eq!(labels.place((98.0, 102.0), "high"), (103.0, 115.0), "below the first");
        let (x, _) = labels.place((395.0, 200.0), "reference, 128");
        assert!(x + LETTER * 14.0 <= 395.0, "to the left of a point at the edge: {x}");
    }
}
