//! The closest point of an implicit surface, and its exact curvatures there.
//!
//! With g = grad F and n = g/|g| (outward), the shape operator is S = P Hess(F) P / |g|, P the
//! projection on the tangent plane. Its eigenvalues are k1 <= k2, **positive where the solid is
//! convex**; H = (k1 + k2)/2 and G = k1 k2. A sphere of radius R has H = 1/R and G = 1/R^2.

use super::ImplicitShape;
use glam::{DMat3, DVec3};

/// The geometry of a surface at one of its points, in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceTruth {
    /// Outward unit normal.
    pub normal: DVec3,
    /// Mean curvature H = (k1 + k2)/2, above 0 where convex, in 1/length.
    pub mean_curvature: f64,
    /// Gaussian curvature G = k1 k2, in 1/length^2.
    pub gaussian_curvature: f64,
    /// The smaller principal curvature, in 1/length.
    pub k1: f64,
    /// The larger principal curvature, in 1/length.
    pub k2: f64,
    /// Unit tangent of k1, of either sign. At an umbilic (k1 = k2), any tangent.
    pub d1: DVec3,
    /// Unit tangent of k2, orthogonal to `d1`; (d1, d2, normal) is direct.
    pub d2: DVec3,
}

/// The point of a surface closest to a given point, in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestPoint {
    /// The point of the surface.
    pub position: DVec3,
    /// Distance of the given point to it, above 0 outside and below 0 inside.
    pub signed_distance: f64,
    /// How far, to first order, `position` is from solving the equations of the closest point: the
    /// distance to the surface and the length of the tangent part of (given point - `position`),
    /// as one length.
    pub residual: f64,
    /// Normal and curvatures at `position`.
    pub truth: SurfaceTruth,
}

/// Residual, as a part of half the longest edge of the shape's box, above which there is no answer:
/// 1e-9 for a box `[-10, 10]^3`.
const ACCEPTED_RESIDUAL: f64 = 1e-10;

/// The longest step, as a part of half the longest edge of the box: a longer one can cross the
/// solid, much shorter ones only take time.
const LONGEST_STEP: f64 = 0.1;

/// Distance, as a part of half the longest edge of the box, up to which the gradient of F is trusted
/// to lead to the closest point. Larger, it may lead elsewhere (deep inside Goursat the gradient
/// vanishes); smaller, every surfel of a coarse digitisation pays for a search in all directions.
const GRADIENT_LEADS: f64 = 0.1;

/// Steps of a ray per half of the longest edge of the box: features of the shape thinner than a
/// step are found by their gradient, or not at all.
const RAY_STEPS: u32 = 64;

/// Two unit tangents t1, t2 such that (t1, t2, n) is direct.
fn tangents(n: DVec3) -> (DVec3, DVec3) {
    // The axis of the smallest component is at least 54 degrees from n.
    let a = n.abs();
    let axis = if a.x <= a.y && a.x <= a.z {
        DVec3::X
    } else if a.y <= a.z {
        DVec3::Y
    } else {
        DVec3::Z
    };
    let t = axis - n * n.dot(axis);
    let t1 = t / t.length();
    (t1, n.cross(t1))
}

/// The terms (a, b; b, c) of a symmetric matrix in the basis (t1, t2).
fn restricted(m: DMat3, t1: DVec3, t2: DVec3) -> (f64, f64, f64) {
    let (m1, m2) = (m * t1, m * t2);
    (t1.dot(m1), t1.dot(m2), t2.dot(m2))
}

/// Normal and curvatures at a point `q` of the surface F = 0.
///
/// Away from the surface it is the geometry of the level set of F through `q`. `None` where the
/// gradient is zero or not finite: no normal there.
pub fn truth_on_surface(shape: &(impl ImplicitShape + ?Sized), q: DVec3) -> Option<SurfaceTruth> {
    let g = shape.gradient(q);
    let length = g.length();
    if !(length > 0.0 && length.is_finite()) {
        return None;
    }
    let n = g / length;
    let (t1, t2) = tangents(n);
    let (a, b, c) = restricted(shape.hessian(q), t1, t2);
    let (a, b, c) = (a / length, b / length, c / length);
    let mean = 0.5 * (a + c);
    let half_difference = 0.5 * (a - c);
    let spread = (half_difference * half_difference + b * b).sqrt();
    // Eigenvector of the larger eigenvalue mean + spread, from the row that does not cancel.
    let (x, y) = if half_difference >= 0.0 {
        (half_difference + spread, b)
    } else {
        (b, spread - half_difference)
    };
    let norm = (x * x + y * y).sqrt();
    let d2 = if norm > 0.0 {
        t1 * (x / norm) + t2 * (y / norm)
    } else {
        t2
    };
    Some(SurfaceTruth {
        normal: n,
        mean_curvature: mean,
        gaussian_curvature: a * c - b * b,
        k1: mean - spread,
        k2: mean + spread,
        d1: d2.cross(n),
        d2,
    })
}

/// One look at the equations of the closest point at `q`: a step towards the solution.
struct Look {
    residual: f64,
    step: DVec3,
    /// Whether the distance to the given point has a strict minimum here, to second order.
    convex: bool,
}

/// The equations are F(q) = 0 and T (p - q) = 0, T the projection on the tangent plane. With the
/// Lagrange multiplier lambda = (p - q).g / |g|^2, Newton's step is -F g/|g|^2 along the normal and
/// along the tangents the solution t of (I + lambda T Hess T) t = T (p - q) - lambda T Hess (normal
/// step).
fn look(shape: &(impl ImplicitShape + ?Sized), p: DVec3, q: DVec3) -> Option<Look> {
    let value = shape.value(q);
    let g = shape.gradient(q);
    let g2 = g.length_squared();
    if !(g2 > 0.0 && g2.is_finite() && value.is_finite()) {
        return None;
    }
    let n = g / g2.sqrt();
    let (t1, t2) = tangents(n);
    let along_normal = g * (-value / g2);
    let lambda = (p - q).dot(g) / g2;
    let hessian = shape.hessian(q);
    let (a, b, c) = restricted(hessian, t1, t2);
    let (a, b, c) = (1.0 + lambda * a, lambda * b, 1.0 + lambda * c);
    let (r1, r2) = (t1.dot(p - q), t2.dot(p - q));
    let twist = lambda * (hessian * along_normal);
    let (s1, s2) = (r1 - t1.dot(twist), r2 - t2.dot(twist));
    let determinant = a * c - b * b;
    let convex = a > 0.0 && determinant > 1e-12;
    let along_tangents = if convex {
        t1 * ((c * s1 - b * s2) / determinant) + t2 * ((a * s2 - b * s1) / determinant)
    } else {
        // Down the distance: away from a maximum or a saddle of it.
        t1 * r1 + t2 * r2
    };
    Some(Look {
        residual: (along_normal.length_squared() + r1 * r1 + r2 * r2).sqrt(),
        step: along_normal + along_tangents,
        convex,
    })
}

/// Down the gradient of F from `q` to the surface, coarsely: Newton does the rest.
fn slide_to_surface(
    shape: &(impl ImplicitShape + ?Sized),
    mut q: DVec3,
    unit: f64,
) -> Option<DVec3> {
    for _ in 0..200 {
        let g = shape.gradient(q);
        let step = g * (-shape.value(q) / g.length_squared());
        let length = step.length();
        if !length.is_finite() {
            return None;
        }
        let longest = LONGEST_STEP * unit;
        q += step * (longest / length.max(longest));
        if length < 1e-6 * unit {
            return Some(q);
        }
    }
    None
}

/// Slides along the surface from `q` to where the distance to `p` is smaller, until the slope is
/// gentle: the way into Newton's basin from a poor start.
fn descend(shape: &(impl ImplicitShape + ?Sized), p: DVec3, mut q: DVec3, unit: f64) -> DVec3 {
    let mut scale = 0.5;
    for _ in 0..400 {
        let g = shape.gradient(q);
        let tangent = (p - q) - g * ((p - q).dot(g) / g.length_squared());
        let length = tangent.length();
        if !(length > 1e-4 * unit && scale > 1e-6) {
            break;
        }
        let step = tangent * (scale * LONGEST_STEP * unit / length.max(LONGEST_STEP * unit));
        match slide_to_surface(shape, q + step, unit) {
            Some(next) if next.distance_squared(p) < q.distance_squared(p) => {
                q = next;
                scale = (2.0 * scale).min(1.0);
            }
            _ => scale *= 0.5,
        }
    }
    q
}

/// Newton from `q`; the solution and its residual when it is a strict local minimum of the distance.
fn newton(
    shape: &(impl ImplicitShape + ?Sized),
    p: DVec3,
    mut q: DVec3,
    unit: f64,
) -> Option<(DVec3, f64)> {
    let mut best: Option<(DVec3, f64)> = None;
    for _ in 0..100 {
        let look = look(shape, p, q)?;
        if look.convex && best.is_none_or(|(_, residual)| look.residual < residual) {
            best = Some((q, look.residual));
        } else if best.is_some_and(|(_, residual)| residual <= ACCEPTED_RESIDUAL * unit) {
            break; // converged: only rounding moves q now
        }
        let longest = LONGEST_STEP * unit;
        q += look.step * (longest / look.step.length().max(longest));
    }
    best.filter(|(_, residual)| *residual <= ACCEPTED_RESIDUAL * unit)
}

/// The nearest place where F changes sign on the 26 rays from `p` to the neighbours of a voxel.
fn nearest_crossing(shape: &(impl ImplicitShape + ?Sized), p: DVec3, unit: f64) -> Option<DVec3> {
    let inside = shape.value(p) <= 0.0;
    let crossed = |q: DVec3| (shape.value(q) <= 0.0) != inside;
    let mut nearest = 2.0 * unit;
    let mut crossing = None;
    for i in 0..27 {
        let axes = DVec3::new(f64::from(i % 3), f64::from(i / 3 % 3), f64::from(i / 9));
        let ray = axes - DVec3::ONE;
        let length = ray.length();
        if length == 0.0 {
            continue;
        }
        let direction = ray / length;
        let step = unit / f64::from(RAY_STEPS);
        let mut t = 0.0;
        while t < nearest {
            if crossed(p + direction * (t + step)) {
                let (mut lo, mut hi) = (t, t + step);
                for _ in 0..40 {
                    let middle = 0.5 * (lo + hi);
                    if crossed(p + direction * middle) {
                        hi = middle;
                    } else {
                        lo = middle;
                    }
                }
                if hi < nearest {
                    nearest = hi;
                    crossing = Some(p + direction * hi);
                }
                break;
            }
            t += step;
        }
    }
    crossing
}

/// The closest point that a start on the surface leads to, with its residual: by Newton, or after
/// a descent. One further than the start would be the closest point of another place.
fn settle(
    shape: &(impl ImplicitShape + ?Sized),
    p: DVec3,
    start: DVec3,
    unit: f64,
) -> Option<(DVec3, f64)> {
    let near_enough =
        |(q, _): &(DVec3, f64)| q.distance(p) <= start.distance(p) * (1.0 + 1e-9) + 1e-6 * unit;
    newton(shape, p, start, unit)
        .filter(near_enough)
        .or_else(|| newton(shape, p, descend(shape, p, start, unit), unit).filter(near_enough))
}

/// The point of the surface F = 0 closest to `p`, with its geometry.
///
/// Newton's method on the Lagrange system of the distance, from where the gradient of F leads (and,
/// when that is far, from the nearest crossing on 26 rays), until rounding stops it: a residual of
/// some 1e-15 of half the longest edge of the shape's box. The residual is at most 1e-10 of that
/// length (1e-9 for a box `[-10, 10]^3`), else there is no answer. The point returned is a strict
/// local minimum of the distance; within the reach of the surface, where the surfels of any fine
/// enough digitisation are, it is *the* closest point.
///
/// `None` when no such point is found: `p` too far, or as close to two places of the surface (the
/// centre of a sphere).
pub fn closest_point(shape: &(impl ImplicitShape + ?Sized), p: DVec3) -> Option<ClosestPoint> {
    let unit = shape.bounding_box().half_longest_edge();
    let by_gradient = slide_to_surface(shape, p, unit).and_then(|q| settle(shape, p, q, unit));
    let (position, residual) = match by_gradient {
        Some(found) if found.0.distance(p) <= GRADIENT_LEADS * unit => found,
        found => {
            let by_rays = nearest_crossing(shape, p, unit).and_then(|q| settle(shape, p, q, unit));
            [found, by_rays]
                .into_iter()
                .flatten()
                .min_by(|a, b| a.0.distance_squared(p).total_cmp(&b.0.distance_squared(p)))?
        }
    };
    let truth = truth_on_surface(shape, position)?;
    let distance = p.distance(position);
    Some(ClosestPoint {
        position,
        signed_distance: if (p - position).dot(truth.normal) < 0.0 {
            -distance
        } else {
            distance
        },
        residual,
        truth,
    })
}

#[cfg(test)]
mod tests {
    use super::super::{Cylinder, Ellipsoid, Goursat, NAMES, Plane, Sphere, Torus, by_name};
    use super::*;
    use std::f64::consts::{PI, TAU};

    /// Points spread evenly in a cube of half edge `half`: a Kronecker sequence.
    fn spread_points(count: u32, half: f64) -> impl Iterator<Item = DVec3> {
        let phi = 1.220_744_084_605_759_5_f64; // the root of x^4 = x + 1
        let a = DVec3::new(1.0 / phi, 1.0 / (phi * phi), 1.0 / (phi * phi * phi));
        (0..count).map(move |i| (a * f64::from(i + 1)).fract() * (2.0 * half) - DVec3::splat(half))
    }

    #[test]
    fn derivatives_agree_with_finite_differences_for_every_shape() {
        for name in NAMES {
            let shape = by_name(name, &[]).unwrap();
            let half = shape.bounding_box().half_longest_edge();
            for p in spread_points(50, half) {
                let e = 1e-5 * half;
                let (g, hessian) = (shape.gradient(p), shape.hessian(p));
                let size = |m: f64| 1e-6 * (m + 1.0);
                for (i, axis) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
                    let (lo, hi) = (p - axis * e, p + axis * e);
                    let slope = (shape.value(hi) - shape.value(lo)) / (2.0 * e);
                    assert!((slope - g[i]).abs() < size(g.length()), "{name} {p}");
                    let bend = (shape.gradient(hi) - shape.gradient(lo)) / (2.0 * e);
                    let column = hessian.col(i);
                    let scale =
                        hessian.col(0).length() + hessian.col(1).length() + hessian.col(2).length();
                    assert!((bend - column).length() < size(scale), "{name} {p}");
                }
                assert_eq!(hessian, hessian.transpose(), "{name}");
            }
        }
    }

    #[test]
    fn closest_points_solve_their_equations_for_every_shape() {
        for name in NAMES {
            let shape = by_name(name, &[]).unwrap();
            let half = shape.bounding_box().half_longest_edge();
            let mut found = 0;
            for p in spread_points(3000, half) {
                // Points near the surface only, as centroids of surfels are.
                if shape.value(p).abs() / shape.gradient(p).length() > 0.02 * half {
                    continue;
                }
                let closest = closest_point(&shape, p)
                    .unwrap_or_else(|| panic!("{name}: no closest point to {p}"));
                found += 1;
                let q = closest.position;
                let n = closest.truth.normal;
                assert!(
                    closest.residual < 1e-12 * half,
                    "{name} {p} {}",
                    closest.residual
                );
                let off = (p - q) - n * closest.signed_distance;
                assert!(off.length() < 1e-12 * half, "{name} {p} {off}");
                // No point around is closer.
                for direction in spread_points(20, 0.3 * half) {
                    if let Some(other) = slide_to_surface(&shape, q + direction, half) {
                        let distance = other.distance(p);
                        let least = closest.signed_distance.abs() - 1e-6 * half;
                        assert!(distance >= least, "{name} {p}: {other} is closer than {q}");
                    }
                }
            }
            assert!(found > 20, "{name}: {found}");
        }
    }

    #[test]
    fn principal_values_and_directions_are_those_of_the_shape_operator() {
        for name in NAMES {
            let shape = by_name(name, &[]).unwrap();
            let half = shape.bounding_box().half_longest_edge();
            for p in spread_points(200, half) {
                let Some(t) = truth_on_surface(&shape, p) else {
                    continue;
                };
                let size = 1e-12 * (1.0 + t.k1.abs().max(t.k2.abs()));
                let g = shape.gradient(p);
                let s = |d: DVec3| {
                    let bent = shape.hessian(p) * d / g.length();
                    bent - t.normal * t.normal.dot(bent)
                };
                assert!(t.k1 <= t.k2);
                assert!((s(t.d1) - t.k1 * t.d1).length() < size, "{name} {p}");
                assert!((s(t.d2) - t.k2 * t.d2).length() < size, "{name} {p}");
                assert!((t.k1 + t.k2 - 2.0 * t.mean_curvature).abs() < size);
                assert!((t.k1 * t.k2 - t.gaussian_curvature).abs() < size * (1.0 + t.k2.abs()));
                assert!((t.d1.cross(t.d2) - t.normal).length() < 1e-14);
            }
        }
    }

    #[test]
    fn a_sphere_has_h_1_over_r_and_g_1_over_r2() {
        for radius in [1e-3, 1.0, 9.0, 12345.0] {
            let sphere = Sphere::new(radius).unwrap();
            for p in spread_points(100, 1.2 * radius) {
                let closest = closest_point(&sphere, p).unwrap();
                let truth = closest.truth;
                let outward = p / p.length();
                assert!((closest.position - radius * outward).length() < 1e-13 * radius);
                let distance = p.length() - radius;
                assert!((closest.signed_distance - distance).abs() < 1e-13 * radius);
                assert!((truth.normal - outward).length() < 1e-13);
                assert!((truth.mean_curvature * radius - 1.0).abs() < 1e-13);
                assert!((truth.gaussian_curvature * radius * radius - 1.0).abs() < 1e-13);
            }
            assert_eq!(closest_point(&sphere, DVec3::ZERO), None);
        }
    }

    #[test]
    fn a_cylinder_has_h_1_over_2r_and_g_0_and_a_plane_has_none() {
        let cylinder = Cylinder::new(5.0, 10.0).unwrap();
        let t = closest_point(&cylinder, DVec3::new(2.0, 3.0, 1.0))
            .unwrap()
            .truth;
        assert!((t.mean_curvature - 0.1).abs() < 1e-15 && t.gaussian_curvature.abs() < 1e-15);
        assert!(t.k1.abs() < 1e-15 && (t.d1.z.abs() - 1.0).abs() < 1e-15);
        let plane = Plane::new(DVec3::new(1.0, 2.0, 2.0), 3.0, 10.0).unwrap();
        let closest = closest_point(&plane, DVec3::new(1.0, 2.0, 5.0)).unwrap();
        assert!((closest.signed_distance - 4.0).abs() < 1e-14);
        assert_eq!((closest.truth.k1, closest.truth.k2), (0.0, 0.0));
    }

    #[test]
    fn a_torus_agrees_with_its_closed_forms_and_its_totals() {
        let (major, minor) = (6.0, 2.0);
        let torus = Torus::new(major, minor).unwrap();
        let count = 64;
        let (mut total_h, mut total_g, mut area) = (0.0, 0.0, 0.0);
        for i in 0..count {
            for j in 0..count {
                let u = TAU * f64::from(i) / f64::from(count);
                let v = TAU * f64::from(j) / f64::from(count);
                let radial = DVec3::new(u.cos(), u.sin(), 0.0);
                let core = major * radial;
                let normal = v.cos() * radial + v.sin() * DVec3::Z;
                let q = core + minor * normal;
                let closest = closest_point(&torus, core + 1.3 * minor * normal).unwrap();
                assert!((closest.position - q).length() < 1e-12);
                let t = closest.truth;
                let k = v.cos() / (major + minor * v.cos());
                assert!((t.k1 - k).abs() < 1e-13 && (t.k2 - 0.5).abs() < 1e-13);
                assert!((t.normal - normal).length() < 1e-13);
                let cell = TAU * TAU / f64::from(count * count);
                let element = minor * (major + minor * v.cos()) * cell;
                area += element;
                total_h += t.mean_curvature * element;
                total_g += t.gaussian_curvature * element;
            }
        }
        assert!((area - 4.0 * PI * PI * major * minor).abs() < 1e-9);
        assert!((total_h - 2.0 * PI * PI * major).abs() < 1e-9, "{total_h}");
        assert!(total_g.abs() < 1e-10, "{total_g}");
    }

    #[test]
    fn an_ellipsoid_totals_4_pi() {
        let (a, b, c) = (9.0, 6.0, 4.0);
        let ellipsoid = Ellipsoid::with_semi_axes(a, b, c).unwrap();
        // Midpoint rule over the sphere, carried to the ellipsoid.
        let (rows, columns) = (160, 160);
        let mut total = 0.0;
        for i in 0..rows {
            for j in 0..columns {
                let theta = PI * (f64::from(i) + 0.5) / f64::from(rows);
                let phi = TAU * (f64::from(j) + 0.5) / f64::from(columns);
                let (s, e) = (
                    theta.sin(),
                    DVec3::new(
                        theta.sin() * phi.cos(),
                        theta.sin() * phi.sin(),
                        theta.cos(),
                    ),
                );
                let axes = DVec3::new(a, b, c);
                let element = (e * DVec3::new(b * c, a * c, a * b)).length()
                    * s
                    * (PI / f64::from(rows))
                    * (TAU / f64::from(columns));
                let truth = truth_on_surface(&ellipsoid, e * axes).unwrap();
                total += truth.gaussian_curvature * element;
            }
        }
        assert!((total - 4.0 * PI).abs() < 1e-3, "{total}");
    }

    #[test]
    fn goursat_has_the_curvatures_of_the_paper() {
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut least_g, mut most_g) = (f64::INFINITY, f64::NEG_INFINITY);
        for p in spread_points(20_000, 10.0) {
            if Goursat.value(p).abs() / Goursat.gradient(p).length() > 0.5 {
                continue;
            }
            let t = closest_point(&Goursat, p).unwrap().truth;
            least = least.min(t.mean_curvature);
            most = most.max(t.mean_curvature);
            least_g = least_g.min(t.gaussian_curvature);
            most_g = most_g.max(t.gaussian_curvature);
        }
        assert!(
            (least + 0.1070).abs() < 1e-3 && (most - 0.3448).abs() < 1e-3,
            "{least} {most}"
        );
        assert!((least_g + 0.0337).abs() < 1e-3 && (most_g - 0.1189).abs() < 1e-3);
    }

    #[test]
    fn within_the_reach_no_point_of_the_whole_surface_is_closer() {
        let samples: Vec<DVec3> = spread_points(20_000, 10.0)
            .filter_map(|p| slide_to_surface(&Goursat, p, 10.0))
            .collect();
        let mut found = 0;
        for p in spread_points(1000, 10.0) {
            let least = samples
                .iter()
                .map(|q| q.distance(p))
                .fold(f64::INFINITY, f64::min);
            // The reach of Goursat is above 2.9 (section 6.1.1 of the paper).
            if least > 2.8 {
                continue;
            }
            let closest = closest_point(&Goursat, p).unwrap_or_else(|| panic!("none at {p}"));
            let distance = closest.signed_distance.abs();
            assert!(distance <= least + 1e-6, "{p}: {distance}, sampled {least}");
            found += 1;
        }
        assert!(found > 250, "{found}");
    }

    #[test]
    fn far_points_and_broken_ones_give_none_not_a_wrong_answer() {
        assert_eq!(closest_point(&Goursat, DVec3::splat(f64::NAN)), None);
        assert_eq!(closest_point(&Goursat, DVec3::splat(f64::INFINITY)), None);
        for p in spread_points(300, 40.0) {
            if let Some(closest) = closest_point(&Goursat, p) {
                assert!(closest.residual <= 1e-9);
            }
        }
    }
}
