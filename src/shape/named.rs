//! Shapes by name, for a command line and its help.

use super::{
    Cylinder, Ellipsoid, Goursat, Gyroid, ImplicitShape, Leopold, Plane, RoundedCube, ShapeError,
    Sphere, Torus,
};
use glam::DVec3;

/// A shape whose type is known at run time only.
pub type BoxedShape = Box<dyn ImplicitShape + Send + Sync>;

/// A parameter of a named shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterInfo {
    /// Its name, as [`by_name`] takes it.
    pub name: &'static str,
    /// Its value when it is not given.
    pub default: f64,
    /// What it means, in a few words.
    pub meaning: &'static str,
}

/// A named shape, as the help shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeInfo {
    /// Its name, as [`by_name`] takes it.
    pub name: &'static str,
    /// What it is, in one line.
    pub description: &'static str,
    /// Its parameters, in world units where they are lengths.
    pub parameters: &'static [ParameterInfo],
}

const fn parameter(name: &'static str, default: f64, meaning: &'static str) -> ParameterInfo {
    ParameterInfo {
        name,
        default,
        meaning,
    }
}

/// The names that [`by_name`] knows, in the order of [`SHAPES`].
pub const NAMES: [&str; 10] = {
    let mut names = [""; 10];
    let mut i = 0;
    while i < names.len() {
        names[i] = SHAPES[i].name;
        i += 1;
    }
    names
};

/// The shapes that [`by_name`] knows.
pub const SHAPES: [ShapeInfo; 10] = [
    ShapeInfo {
        name: "goursat",
        description: "0.03(x^4+y^4+z^4) - 2(x^2+y^2+z^2) - 8 <= 0, the smooth cube with dents of \
                      the papers, in [-10, 10]^3",
        parameters: &[],
    },
    ShapeInfo {
        name: "sphere",
        description: "a ball: H = 1/radius, G = 1/radius^2",
        parameters: &[parameter("radius", 9.0, "radius")],
    },
    ShapeInfo {
        name: "torus",
        description: "a torus around the z axis: the integral of G is 0",
        parameters: &[
            parameter("major", 6.0, "radius from the axis to the core circle"),
            parameter("minor", 2.0, "radius around the core circle"),
        ],
    },
    ShapeInfo {
        name: "ellipsoid",
        description: "an ellipsoid of semi-axes a, b, c along x, y, z",
        parameters: &[
            parameter("a", 9.0, "semi-axis along x"),
            parameter("b", 6.0, "semi-axis along y"),
            parameter("c", 4.0, "semi-axis along z"),
        ],
    },
    ShapeInfo {
        name: "ellipsoid90",
        description: "3x^2 + 2y^2 + z^2 - 90 <= 0, the ellipsoid of DGtal, in [-10, 10]^3",
        parameters: &[],
    },
    ShapeInfo {
        name: "rcube",
        description: "x^4 + y^4 + z^4 <= half_edge^4, a cube with round edges and flat spots",
        parameters: &[parameter("half_edge", 9.0, "half of its width")],
    },
    ShapeInfo {
        name: "leopold",
        description: "x^2y^2z^2 + 4x^2 + 4y^2 + 3z^2 - 100 <= 0, six blunt arms, in [-6, 6]^3",
        parameters: &[],
    },
    ShapeInfo {
        name: "cylinder",
        description: "a cylinder along z, cut by the border of the image: H = 1/(2 radius), G = 0",
        parameters: &[
            parameter("radius", 6.0, "radius"),
            parameter("half_length", 10.0, "half of the length digitised"),
        ],
    },
    ShapeInfo {
        name: "plane",
        description: "the half space nx x + ny y + nz z <= level, cut by the border: H = G = 0",
        parameters: &[
            parameter("nx", 2.0, "outward normal along x, of any length"),
            parameter("ny", 6.0, "outward normal along y"),
            parameter("nz", 15.0, "outward normal along z"),
            parameter("level", 0.0, "level of the plane"),
            parameter("half_edge", 10.0, "half edge of the cube digitised"),
        ],
    },
    ShapeInfo {
        name: "gyroid",
        description: "sin X cos Y + sin Y cos Z + sin Z cos X <= level, periodic, cut by the border",
        parameters: &[
            parameter("period", 10.0, "period along each axis"),
            parameter("level", 0.0, "between -1.5 (all empty) and 1.5 (all full)"),
            parameter("half_edge", 10.0, "half edge of the cube digitised"),
        ],
    },
];

/// The shape of this name, with these parameters and the default for all others.
///
/// # Errors
/// If the name or a parameter is unknown (the error lists the known ones), a parameter is given
/// twice, or a value makes no shape.
pub fn by_name(name: &str, parameters: &[(&str, f64)]) -> Result<BoxedShape, ShapeError> {
    let Some(info) = SHAPES.iter().find(|info| info.name == name) else {
        return Err(ShapeError::UnknownShape {
            name: name.to_string(),
            known: NAMES.join(", "),
        });
    };
    for (i, (given, _)) in parameters.iter().enumerate() {
        if !info.parameters.iter().any(|known| known.name == *given) {
            let known: Vec<&str> = info.parameters.iter().map(|known| known.name).collect();
            return Err(ShapeError::UnknownParameter {
                shape: info.name,
                name: given.to_string(),
                known: if known.is_empty() {
                    "none".to_string()
                } else {
                    known.join(", ")
                },
            });
        }
        if parameters[..i].iter().any(|(earlier, _)| earlier == given) {
            return Err(ShapeError::RepeatedParameter {
                shape: info.name,
                name: given.to_string(),
            });
        }
    }
    // The values in the order of `info.parameters`.
    let value: Vec<f64> = info
        .parameters
        .iter()
        .map(|known| {
            parameters
                .iter()
                .find(|(given, _)| *given == known.name)
                .map_or(known.default, |(_, value)| *value)
        })
        .collect();
    Ok(match info.name {
        "goursat" => Box::new(Goursat),
        "sphere" => Box::new(Sphere::new(value[0])?),
        "torus" => Box::new(Torus::new(value[0], value[1])?),
        "ellipsoid" => Box::new(Ellipsoid::with_semi_axes(value[0], value[1], value[2])?),
        "ellipsoid90" => Box::new(Ellipsoid::dgtal()),
        "rcube" => Box::new(RoundedCube::new(value[0])?),
        "leopold" => Box::new(Leopold),
        "cylinder" => Box::new(Cylinder::new(value[0], value[1])?),
        "plane" => Box::new(Plane::new(
            DVec3::new(value[0], value[1], value[2]),
            value[3],
            value[4],
        )?),
        "gyroid" => Box::new(Gyroid::new(value[0], value[1], value[2])?),
        name => unreachable!("`{name}` is listed and not built"),
    })
}

/// The shape that a text such as `goursat` or `torus:major=6,minor=2` describes.
///
/// # Errors
/// As [`by_name`], and if a parameter is not `name=number`.
pub fn by_spec(spec: &str) -> Result<BoxedShape, ShapeError> {
    let (name, list) = match spec.split_once(':') {
        Some((name, list)) => (name, Some(list)),
        None => (spec, None),
    };
    let mut parameters = Vec::new();
    for item in list.into_iter().flat_map(|list| list.split(',')) {
        let pair = item
            .split_once('=')
            .and_then(|(name, value)| Some((name.trim(), value.trim().parse::<f64>().ok()?)));
        parameters.push(pair.ok_or_else(|| ShapeError::Spec {
            spec: spec.to_string(),
            found: item.to_string(),
        })?);
    }
    by_name(name.trim(), &parameters)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error_of(result: Result<BoxedShape, ShapeError>) -> ShapeError {
        match result {
            Ok(_) => panic!("an error was expected"),
            Err(error) => error,
        }
    }

    #[test]
    fn every_name_makes_a_shape_with_its_defaults() {
        for info in &SHAPES {
            let shape = by_name(info.name, &[]).unwrap();
            assert!(shape.bounding_box().half_longest_edge() > 0.0);
            assert!(!info.description.contains('\n') && info.description.len() < 120);
            let given: Vec<_> = info
                .parameters
                .iter()
                .map(|p| (p.name, p.default))
                .collect();
            assert_eq!(
                by_name(info.name, &given).unwrap().value(DVec3::ONE),
                shape.value(DVec3::ONE),
                "{}",
                info.name
            );
        }
    }

    #[test]
    fn unknown_names_list_the_known_ones() {
        let message = error_of(by_name("teapot", &[])).to_string();
        for name in NAMES {
            assert!(message.contains(name), "{message}");
        }
        let message = error_of(by_name("torus", &[("radius", 1.0)])).to_string();
        assert!(message.contains("major, minor"), "{message}");
        let message = error_of(by_name("goursat", &[("radius", 1.0)])).to_string();
        assert!(message.contains("none"), "{message}");
    }

    #[test]
    fn values_that_make_no_shape_are_errors() {
        for spec in [
            "sphere:radius=0",
            "sphere:radius=-1",
            "sphere:radius=nan",
            "sphere:radius=inf",
            "sphere:radius=1e300",
            "torus:major=2,minor=2",
            "ellipsoid:c=0",
            "rcube:half_edge=0",
            "cylinder:half_length=0",
            "plane:nx=0,ny=0,nz=0",
            "plane:level=inf",
            "gyroid:level=1.5",
            "gyroid:period=0",
        ] {
            let error = error_of(by_spec(spec));
            assert!(
                matches!(error, ShapeError::Parameter { .. }),
                "{spec}: {error}"
            );
        }
        let error = error_of(by_name("sphere", &[("radius", 1.0), ("radius", 2.0)]));
        assert!(matches!(error, ShapeError::RepeatedParameter { .. }));
    }

    #[test]
    fn a_text_describes_a_shape() {
        let torus = by_spec("torus: major=5, minor=1").unwrap();
        assert_eq!(torus.bounding_box().hi, DVec3::new(6.0, 6.0, 1.0));
        for spec in [
            "sphere:",
            "sphere:radius",
            "sphere:radius=x",
            "sphere:radius=1,",
        ] {
            let error = error_of(by_spec(spec));
            assert!(matches!(error, ShapeError::Spec { .. }), "{spec}: {error}");
        }
    }
}
