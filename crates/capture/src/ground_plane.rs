//! Finds the ground under the subject, or the table top, in the sparse points of a capture.

use glam::{DMat3, DMat4, DVec3};

use crate::bounds::nearest_to_axes;
use crate::camera_up::CameraUp;
use crate::formats::ply_points::Point;
use crate::symmetric::{eigen, outer};

/// Greatest number of points and of cameras that the search uses; the fit uses all points.
const SEARCHED: [usize; 2] = [20_000, 200];
/// Greatest number of points to which planes are fitted; of more, evenly spaced ones are used.
const FITTED: usize = 1_000_000;
/// Angles from the up direction of the cameras within which normals are tried, and their distance, degrees; and half the thickness
/// of the plane in radii of the ball. A coarse level is followed by finer ones around its best plane.
const LEVELS: [(f64, f64, f64); 3] = [(45.0, 3.0, 0.04), (6.0, 1.5, 0.02), (3.0, 0.75, 0.01)];
/// Greatest number of least squares fits of a plane to the points near it.
const FITS: usize = 8;
/// Least number of points in the ball, and on the plane.
const LEAST_POINTS: [usize; 2] = [100, 40];
/// Least share of the points of the ball that lie on the plane.
const LEAST_SHARE: f64 = 0.03;
/// Largest number of points below the plane, relative to those on it. Shiny floors have reflections.
const BELOW: f64 = 0.5;
/// Largest standard deviation of the heights of the points on the plane relative to half its thickness; 0.577 without a plane.
const THIN: f64 = 0.47;
/// Least ratio of the number of points on the plane and in an equally thick layer beside it, and least difference.
const CONTRAST: (f64, f64) = (2.0, 30.0);
/// Least standard deviation of the points on the plane along its shorter side, radii of the ball.
const LEAST_EXTENT: f64 = 0.1;
/// Least share of the cameras that stand above the plane.
const CAMERAS_ABOVE: f64 = 0.95;

/// A level plane under the subject.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GroundPlane {
    /// Unit length, towards the cameras.
    pub normal: DVec3,
    /// Number of points on the plane.
    pub points: usize,
}

/// The ground in the ball that the cameras look at: the plane with most points on it and few below it, which agrees with
/// `cameras` and has the cameras above it. `None` if there is none. The search is exhaustive and deterministic; its time is at most
/// that of about 2,500 passes over [`SEARCHED`] points and 100 over [`FITTED`] points.
pub(super) fn find(points: &[Point], poses: &[DMat4], cameras: &CameraUp) -> Option<GroundPlane> {
    let eyes: Vec<DVec3> = poses.iter().map(|pose| pose.w_axis.truncate()).collect();
    let views = poses.iter().map(|pose| -pose.z_axis.truncate().normalize_or_zero());
    let centre = nearest_to_axes(eyes.iter().copied().zip(views));
    let distance = median(eyes.iter().map(|eye| eye.distance(centre)))?;
    let points_reach = median(every(points, SEARCHED[0]).map(|(point, _)| point.distance(centre)))?;
    // Cameras that turn on the spot in a room are near their centre; the floor is not.
    let radii = [distance, 2.0 * distance, points_reach];
    let radii = radii.iter().enumerate().filter(|(i, r)| *i < 2 || **r > radii[1]).map(|(_, r)| *r);
    let is_usable = |radius: &f64| radius.is_finite() && *radius > 0.0;
    radii.filter(is_usable).find_map(|radius| Ball::new(points, &eyes, centre, radius).ground(cameras))
}

/// The points around the centre, in units of its radius.
struct Ball<'a> {
    all: &'a [Point],
    centre: DVec3,
    radius: f64,
    /// The points of the search.
    points: Vec<DVec3>,
    /// The cameras of the search.
    eyes: Vec<DVec3>,
}

impl<'a> Ball<'a> {
    fn new(all: &'a [Point], eyes: &[DVec3], centre: DVec3, radius: f64) -> Self {
        let eyes = every(eyes, SEARCHED[1]).map(|eye| (*eye - centre) / radius).collect();
        let mut ball = Self { all, centre, radius, points: Vec::new(), eyes };
        let step = ball.inside().count().div_ceil(SEARCHED[0]).max(1);
        ball.points = ball.inside().step_by(step).collect();
        ball
    }

    /// The points of the ball, of at most [`FITTED`] points of the capture.
    fn inside(&self) -> impl Iterator<Item = DVec3> + '_ {
        let local = |(point, _): &Point| (*point - self.centre) / self.radius;
        every(self.all, FITTED).map(local).filter(|point| point.length_squared() < 1.0)
    }

    fn ground(&self, cameras: &CameraUp) -> Option<GroundPlane> {
        if self.points.len() < LEAST_POINTS[0] {
            return None;
        }
        let (mut ground, mut middle) = (None, cameras.direction);
        for (reach, step, thickness) in LEVELS {
            let tried = directions(middle, reach, step).filter(|normal| cameras.accepts(*normal));
            let best = tried.filter_map(|normal| self.best_height(normal, thickness));
            let best = best.max_by(|a, b| a.score.cmp(&b.score))?;
            middle = best.normal;
            // The finest level at which there is a plane gives the most accurate one.
            ground = self.fitted(best, thickness, cameras).or(ground);
        }
        ground
    }

    /// The height along `normal` at which a plane has most points on it minus points below it.
    fn best_height(&self, normal: DVec3, thickness: f64) -> Option<Candidate> {
        let bins = (2.0 / thickness).ceil() as usize;
        let mut counts = vec![0i64; bins + 1];
        for point in &self.points {
            counts[(((point.dot(normal) + 1.0) / thickness) as usize).min(bins)] += 1;
        }
        let mut eyes: Vec<f64> = self.eyes.iter().map(|eye| eye.dot(normal)).collect();
        eyes.sort_by(f64::total_cmp);
        let lowest = *eyes.get(((1.0 - CAMERAS_ABOVE) * eyes.len() as f64) as usize)?;
        let (mut below, mut best) = (0, None::<Candidate>);
        for (i, pair) in counts.windows(2).enumerate() {
            let height = (i + 1) as f64 * thickness - 1.0;
            let score = pair[0] + pair[1] - below;
            if height < lowest && best.is_none_or(|best| best.score < score) {
                best = Some(Candidate { normal, height, score });
            }
            below += pair[0];
        }
        best
    }

    /// The least squares plane of the points near a candidate, if it is a plane and the ground.
    fn fitted(&self, candidate: Candidate, thickness: f64, cameras: &CameraUp) -> Option<GroundPlane> {
        let Candidate { mut normal, mut height, .. } = candidate;
        let mut on = Moments::NONE;
        for _ in 0..FITS {
            on = Moments::NONE;
            let is_on = |point: &DVec3| (point.dot(normal) - height).abs() < thickness;
            self.inside().filter(is_on).for_each(|point| on.add(point));
            if on.count < LEAST_POINTS[1] {
                return None;
            }
            let fitted = on.normal(normal);
            let is_done = fitted.dot(normal) > 1.0 - 1e-12;
            (normal, height) = (fitted, on.mean().dot(fitted));
            if is_done {
                break;
            }
        }
        let layers = self.layers(normal, height, thickness);
        let [deviation, extent, _] = on.deviations();
        let above = self.eyes.iter().filter(|eye| eye.dot(normal) - height > thickness).count();
        let is_ground = cameras.accepts(normal)
            && layers.is_plane()
            && deviation <= THIN * thickness
            && extent >= LEAST_EXTENT
            && above as f64 >= CAMERAS_ABOVE * self.eyes.len() as f64;
        is_ground.then_some(GroundPlane { normal, points: layers.on })
    }

    fn layers(&self, normal: DVec3, height: f64, thickness: f64) -> Layers {
        let mut layers = Layers::default();
        for point in self.inside() {
            let h = (point.dot(normal) - height) / thickness;
            layers.all += 1;
            layers.on += usize::from(h.abs() < 1.0);
            layers.beside += usize::from((1.0..3.0).contains(&h.abs()));
            layers.below += usize::from(h <= -1.0);
        }
        layers
    }
}

/// A plane of the search.
#[derive(Clone, Copy)]
struct Candidate {
    normal: DVec3,
    height: f64,
    score: i64,
}

/// Numbers of points of the ball: all, on the plane, in two layers of its thickness beside it, and below it.
#[derive(Default)]
struct Layers {
    all: usize,
    on: usize,
    beside: usize,
    below: usize,
}

impl Layers {
    fn is_plane(&self) -> bool {
        let [all, on, beside, below] = [self.all, self.on, self.beside, self.below].map(|n| n as f64);
        let (ratio, difference) = CONTRAST;
        on >= LEAST_SHARE * all && below <= BELOW * on && on >= ratio * 0.5 * beside + difference
    }
}

/// Moments of points, for the plane of least squares.
struct Moments {
    count: usize,
    sum: DVec3,
    products: DMat3,
}

impl Moments {
    const NONE: Self = Self { count: 0, sum: DVec3::ZERO, products: DMat3::ZERO };

    fn add(&mut self, point: DVec3) {
        self.count += 1;
        self.sum += point;
        self.products += outer(point);
    }

    fn mean(&self) -> DVec3 {
        self.sum / self.count.max(1) as f64
    }

    fn covariance(&self) -> DMat3 {
        self.products * (1.0 / self.count.max(1) as f64) - outer(self.mean())
    }

    /// The direction in which the points spread least, on the side of `towards`.
    fn normal(&self, towards: DVec3) -> DVec3 {
        let normal = eigen(self.covariance()).vectors[0];
        if normal.dot(towards) < 0.0 { -normal } else { normal }
    }

    /// Standard deviations along the principal axes, ascending.
    fn deviations(&self) -> [f64; 3] {
        eigen(self.covariance()).values.map(|value| value.max(0.0).sqrt())
    }
}

/// Unit vectors on a square grid of `step` degrees within `reach` degrees of `middle`.
fn directions(middle: DVec3, reach: f64, step: f64) -> impl Iterator<Item = DVec3> {
    let (x, y) = middle.any_orthonormal_pair();
    let steps = (reach / step).round() as i32;
    let grid =
        (-steps..=steps).flat_map(move |i| (-steps..=steps).map(move |j| (f64::from(i), f64::from(j))));
    grid.filter(move |(i, j)| i.hypot(*j) <= f64::from(steps)).map(move |(i, j)| {
        let angle = (step * i.hypot(j)).to_radians();
        let across = (x * i + y * j).normalize_or_zero();
        middle * angle.cos() + across * angle.sin()
    })
}

/// At most `most` evenly spaced items.
fn every<T>(items: &[T], most: usize) -> impl Iterator<Item = &T> {
    items.iter().step_by(items.len().div_ceil(most).max(1))
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
