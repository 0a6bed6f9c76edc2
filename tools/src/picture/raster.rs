//! Parallelograms on a canvas, the nearest in front.

use glam::{DVec2, DVec3};

use super::image::{Image, srgb};

/// Samples of a pixel along each side.
pub(super) const SAMPLES: usize = 2;

/// How far a parallelogram reaches beyond its edges, as a share of them. At 0, rounding opens
/// cracks between neighbours; much larger, silhouettes grow.
const EDGE_SLACK: f64 = 1e-6;

/// What one sample shows.
#[derive(Clone, Copy)]
struct Sample {
    /// Towards the eye; minus infinity where there is nothing.
    depth: f32,
    /// Linear light.
    colour: [f32; 3],
}

/// Samples with their depths. Coordinates: x to the right and y down, in samples, z to the eye.
pub(super) struct Canvas {
    /// Width and height, in samples.
    size: [usize; 2],
    samples: Vec<Sample>,
}

impl Canvas {
    /// An empty canvas for a picture of so many pixels.
    pub(super) fn new(pixels: [usize; 2]) -> Self {
        let size = pixels.map(|n| n * SAMPLES);
        let nothing = Sample {
            depth: f32::NEG_INFINITY,
            colour: [1.0; 3],
        };
        Self {
            size,
            samples: vec![nothing; size[0] * size[1]],
        }
    }

    /// Draws the parallelogram of that centre and those edges. One seen edge-on is not seen.
    pub(super) fn draw(&mut self, centre: DVec3, edges: [DVec3; 2], colour: [f32; 3]) {
        let [a, b] = edges;
        let det = a.truncate().perp_dot(b.truncate());
        let half = 0.5 * (a.truncate().abs() + b.truncate().abs());
        // The slack times half the edges is less than this.
        let reach = half * (1.0 + 2.0 * EDGE_SLACK);
        let [Some(columns), Some(rows)] =
            [0, 1].map(|i| covered(centre[i] - reach[i], centre[i] + reach[i], self.size[i]))
        else {
            return;
        };
        if det == 0.0 {
            return;
        }
        let inside = |share: f64| share.abs() <= 0.5 + EDGE_SLACK;
        for y in rows {
            for x in columns.clone() {
                let offset = DVec2::new(x as f64 + 0.5, y as f64 + 0.5) - centre.truncate();
                // offset = s a + t b
                let s = offset.perp_dot(b.truncate()) / det;
                let t = a.truncate().perp_dot(offset) / det;
                if !(inside(s) && inside(t)) {
                    continue;
                }
                let depth = (centre.z + s * a.z + t * b.z) as f32;
                let sample = &mut self.samples[y * self.size[0] + x];
                if depth > sample.depth {
                    *sample = Sample { depth, colour };
                }
            }
        }
    }

    /// The picture, on white: each pixel the mean of its samples in linear light.
    pub(super) fn into_image(self, image: &mut Image) {
        let share = 1.0 / (SAMPLES * SAMPLES) as f32;
        for y in 0..self.size[1] / SAMPLES {
            for x in 0..self.size[0] / SAMPLES {
                let mut sum = [0.0; 3];
                for row in y * SAMPLES..(y + 1) * SAMPLES {
                    for sample in &self.samples[row * self.size[0] + x * SAMPLES..][..SAMPLES] {
                        for (sum, channel) in sum.iter_mut().zip(sample.colour) {
                            *sum += channel;
                        }
                    }
                }
                image.fill([x, y], [1, 1], srgb(sum.map(|channel| channel * share)));
            }
        }
    }
}

/// The samples of 0..`size` whose centres lie from `low` to `high`; `None` if there are none, or
/// if an end is NaN.
fn covered(low: f64, high: f64, size: usize) -> Option<std::ops::Range<usize>> {
    // Both casts saturate, so what is beyond the canvas is cut off.
    let from = (low - 0.5).ceil().max(0.0) as usize;
    let to = ((high + 0.5).floor().max(0.0) as usize).min(size);
    (low <= high && from < to).then_some(from..to)
}
