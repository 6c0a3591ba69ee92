//! The cameras of a capture as an SVG picture: from above and from the side.

use std::fmt::Write;

use glam::DVec3;
use relume_capture::PhotoCamera;
use relume_spec::CaptureReport;

/// Side of a panel and width of the space around it, pixels.
const PANEL: f64 = 480.0;
const MARGIN: f64 = 40.0;
/// Largest number of points that are drawn.
const POINTS: usize = 4000;
/// Length of a camera's drawing relative to the panel.
const CAMERA: f64 = 0.03;
/// Camera colours: trained on, held out.
const COLOURS: [&str; 2] = ["#2a6fb0", "#d9822b"];

/// A view of the world along an axis.
struct Panel {
    title: &'static str,
    /// World directions of right and up in the panel, with their names.
    right: (DVec3, &'static str),
    up: (DVec3, &'static str),
    left: f64,
}

/// Maps the world to a panel.
struct Scale {
    centre: DVec3,
    /// World length that fills half of a panel.
    reach: f64,
}

/// The picture of `cameras` and `points` around the region of interest of `report`.
pub(super) fn rig_svg(cameras: &[PhotoCamera], points: &[DVec3], report: &CaptureReport) -> String {
    let centre = DVec3::from(report.centre);
    let mut distances: Vec<f64> = cameras.iter().map(|c| (c.camera.centre() - centre).length()).collect();
    distances.sort_by(f64::total_cmp);
    // A stray camera must not make the others too small to see.
    let usual = distances.get(distances.len() * 9 / 10).copied().unwrap_or(1.0);
    let scale = Scale { centre, reach: 1.25 * usual.max(report.radius).max(1e-9) };
    let panels = [
        Panel { title: "from above", right: (DVec3::X, "+X"), up: (DVec3::Y, "+Y"), left: MARGIN },
        Panel {
            title: "from the side",
            right: (DVec3::X, "+X"),
            up: (DVec3::Z, "+Z, up"),
            left: PANEL + 2.0 * MARGIN,
        },
    ];
    let (width, height) = (2.0 * PANEL + 3.0 * MARGIN, PANEL + 3.0 * MARGIN);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
         font-size=\"13\" fill=\"#333\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    for panel in &panels {
        panel.draw(&mut svg, &scale, cameras, points, report.radius);
    }
    legend(&mut svg, points.is_empty(), report.radius);
    svg.push_str("</svg>\n");
    svg
}

/// Explains the signs below the panels.
fn legend(svg: &mut String, is_without_points: bool, radius: f64) {
    let y = PANEL + 2.4 * MARGIN;
    let mut x = MARGIN + 5.0;
    let mut entry = |colour: &str, radius: f64, text: &str| {
        let _ = writeln!(
            svg,
            "<circle cx=\"{x}\" cy=\"{}\" r=\"{radius}\" fill=\"{colour}\"/><text x=\"{}\" y=\"{y}\">{text}</text>",
            y - 4.5,
            x + 12.0
        );
        x += 36.0 + 6.6 * text.len() as f64;
    };
    entry(COLOURS[0], 5.0, "camera and its view, trained on");
    entry(COLOURS[1], 5.0, "held out");
    if !is_without_points {
        entry("#999", 2.0, "sparse points");
    }
    entry("#ccc", 5.0, &format!("region of interest, radius {radius:.3} units"));
}

/// The largest of 1, 2 and 5 times a power of ten that is at most `length`.
fn round_length(length: f64) -> f64 {
    let power = 10f64.powf(length.log10().floor());
    [5.0, 2.0].into_iter().map(|step| step * power).find(|step| *step <= length).unwrap_or(power)
}

impl Panel {
    fn draw(&self, svg: &mut String, scale: &Scale, cameras: &[PhotoCamera], points: &[DVec3], radius: f64) {
        let (left, title) = (self.left, self.title);
        let _ = writeln!(
            svg,
            "<g><clipPath id=\"p{left}\"><rect x=\"{left}\" y=\"{MARGIN}\" width=\"{PANEL}\" height=\"{PANEL}\"/></clipPath>\
             <text x=\"{left}\" y=\"{}\" font-weight=\"bold\">{title}</text>\
             <rect x=\"{left}\" y=\"{MARGIN}\" width=\"{PANEL}\" height=\"{PANEL}\" fill=\"none\" stroke=\"#bbb\"/>\
             <g clip-path=\"url(#p{left})\">",
            MARGIN - 10.0
        );
        for point in points.iter().step_by(points.len().div_ceil(POINTS).max(1)) {
            let (x, y) = self.place(scale, *point);
            let _ = writeln!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"0.8\" fill=\"#999\"/>");
        }
        let (x, y) = self.place(scale, scale.centre);
        let r = radius / scale.reach * 0.5 * PANEL;
        let _ =
            writeln!(svg, "<circle cx=\"{x}\" cy=\"{y}\" r=\"{r:.1}\" fill=\"#8882\" stroke=\"#888\"/></g>");
        cameras.iter().for_each(|camera| self.draw_camera(svg, scale, camera));
        self.draw_scale(svg, scale);
        let (bottom, right) = (MARGIN + PANEL, left + PANEL);
        let _ = writeln!(
            svg,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text><text x=\"{}\" y=\"{}\">{}</text></g>",
            right - 6.0,
            bottom - 8.0,
            self.right.1,
            left + 6.0,
            MARGIN + 16.0,
            self.up.1
        );
    }

    /// A bar of a round length.
    fn draw_scale(&self, svg: &mut String, scale: &Scale) {
        let length = round_length(0.5 * scale.reach);
        let (x, y) = (self.left + 12.0, MARGIN + PANEL - 12.0);
        let end = x + length / scale.reach * 0.5 * PANEL;
        let _ = writeln!(
            svg,
            "<path d=\"M{x} {}V{y}H{end:.1}V{}\" fill=\"none\" stroke=\"#333\"/><text x=\"{:.1}\" y=\"{y}\">{length} units</text>",
            y - 5.0,
            y - 5.0,
            end + 6.0
        );
    }

    /// A triangle from the camera's centre to the sides of its view. A camera outside the panel is drawn at its edge.
    fn draw_camera(&self, svg: &mut String, scale: &Scale, camera: &PhotoCamera) {
        let centre = camera.camera.centre();
        let (x, y) = self.place(scale, centre);
        let (low, high) = (self.left + 4.0, self.left + PANEL - 4.0);
        let inside = (x.clamp(low, high), y.clamp(MARGIN + 4.0, MARGIN + PANEL - 4.0));
        let colour = COLOURS[usize::from(camera.is_held_out)];
        let name = escaped(&camera.name);
        let ahead = |side: f64| {
            let across =
                camera.camera.rotation.row(0) * (0.5 * f64::from(camera.camera.width) / camera.camera.fx);
            let towards = (camera.camera.forward() + side * across) * (2.0 * CAMERA * scale.reach);
            let (u, v) = self.place(scale, centre + towards);
            (u - x + inside.0, v - y + inside.1)
        };
        let ((ax, ay), (bx, by)) = (ahead(-1.0), ahead(1.0));
        let _ = writeln!(
            svg,
            "<g stroke=\"{colour}\" fill=\"{colour}44\"><title>{name}</title><path d=\"M{:.1} {:.1}L{ax:.1} {ay:.1}L{bx:.1} \
             {by:.1}Z\"/><circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.5\" fill=\"{colour}\"/></g>",
            inside.0, inside.1, inside.0, inside.1
        );
    }

    /// Pixel position of a world point.
    fn place(&self, scale: &Scale, point: DVec3) -> (f64, f64) {
        let offset = (point - scale.centre) / scale.reach * 0.5 * PANEL;
        let (right, up) = (offset.dot(self.right.0), offset.dot(self.up.0));
        (self.left + 0.5 * PANEL + right, MARGIN + 0.5 * PANEL - up)
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::Camera;

    fn camera(name: &str, eye: DVec3, is_held_out: bool) -> PhotoCamera {
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, (80, 60)).unwrap();
        PhotoCamera { name: name.to_owned(), is_held_out, camera, light_rotation_deg: 0.0 }
    }

    #[test]
    fn each_camera_is_drawn_in_both_panels() {
        let cameras = [
            camera("a.png", DVec3::new(3.0, 0.0, 1.0), false),
            camera("<b>.png", DVec3::new(0.0, 3.0, 1.0), true),
        ];
        let report = CaptureReport { radius: 1.0, ..CaptureReport::default() };
        let svg = rig_svg(&cameras, &[DVec3::ZERO], &report);
        for name in ["a.png", "&lt;b&gt;.png"] {
            assert_eq!(svg.matches(&format!("<title>{name}</title>")).count(), 2, "{name}");
        }
        assert_eq!(svg.matches(&format!("<g stroke=\"{}\"", COLOURS[1])).count(), 2);
        assert!(svg.ends_with("</svg>\n"));
    }

    #[test]
    fn scale_bar_has_a_round_length() {
        for (length, round) in [(0.7, 0.5), (3.9, 2.0), (1.0, 1.0), (1900.0, 1000.0), (0.05, 0.05)] {
            assert!((round_length(length) / round - 1.0).abs() < 1e-9, "{length}: {}", round_length(length));
        }
    }

    #[test]
    fn a_stray_camera_is_drawn_at_the_edge() {
        let on_ring = |i: u32| DVec3::new(3.0 * f64::from(i).cos(), 3.0 * f64::from(i).sin(), 1.0);
        let mut cameras: Vec<_> = (0..12).map(|i| camera("a", on_ring(i), false)).collect();
        let report = CaptureReport { radius: 1.0, ..CaptureReport::default() };
        let near = rig_svg(&cameras, &[], &report);
        cameras.push(camera("stray", DVec3::new(4000.0, 0.0, 1.0), false));
        let far = rig_svg(&cameras, &[], &report);
        let first = |svg: &str| svg.split("<path d=\"").nth(1).unwrap().split('L').next().unwrap().to_owned();
        assert_eq!(first(&near), first(&far), "the scale is that of the other cameras");
    }
}
