//! Where a picture is seen from.

use std::str::FromStr;

use glam::DVec3;

/// Below this share of its length off the z axis, a direction counts as along z, where world z
/// cannot be up. Larger would tilt views that have an up; smaller would let rounding decide it.
const ALONG_Z: f64 = 1e-6;

/// The direction from the scene to the eye, in world axes, of any length but 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View(DVec3);

impl Default for View {
    /// From the right and above, looking mostly along +y.
    fn default() -> Self {
        Self(DVec3::new(1.0, -1.6, 0.9))
    }
}

impl FromStr for View {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || {
            format!(
                "found {text:?}, expected the direction to the eye, X,Y,Z or one of x -x y -y z -z"
            )
        };
        let eye = match text {
            "x" => DVec3::X,
            "-x" => DVec3::NEG_X,
            "y" => DVec3::Y,
            "-y" => DVec3::NEG_Y,
            "z" => DVec3::Z,
            "-z" => DVec3::NEG_Z,
            _ => {
                let numbers = text.split(',').map(|n| n.trim().parse());
                let numbers: Result<Vec<f64>, _> = numbers.collect();
                let numbers = numbers.map_err(|_| expected())?;
                DVec3::from_array(numbers.try_into().map_err(|_| expected())?)
            }
        };
        // Neither 0, nor infinite, nor NaN.
        eye.try_normalize().map(Self).ok_or_else(expected)
    }
}

/// Unit vectors of a picture, at right angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// To the right in the picture.
    pub right: DVec3,
    /// Up in the picture.
    pub up: DVec3,
    /// Out of the picture, to the viewer.
    pub eye: DVec3,
}

impl View {
    /// The vectors of the picture; up is nearest to world z, or to y in views along z.
    #[must_use]
    pub fn frame(self) -> Frame {
        let eye = self.0.normalize();
        let above = if eye.truncate().length() < ALONG_Z {
            DVec3::Y
        } else {
            DVec3::Z
        };
        let right = above.cross(eye).normalize();
        let up = eye.cross(right);
        Frame { right, up, eye }
    }
}

impl Frame {
    /// A world vector as (right, up, towards the eye).
    #[must_use]
    pub fn world_to_frame(&self, v: DVec3) -> DVec3 {
        DVec3::new(self.right.dot(v), self.up.dot(v), self.eye.dot(v))
    }
}
