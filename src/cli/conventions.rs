//! The conventions in words: in the metadata of every table, in `summary.json`, and in `--help`.

use crate::curvature::Method;

/// What the principal curvatures are, beside H and G.
pub(super) const PRINCIPAL: &str = "k1 and k2 are of the curvature tensor averaged over the ball, so (k1 + k2)/2 \
     differs from H and k1 k2 from G (principal_mismatch_rms of summary.json: by how much the first); shape \
     indices that agree with H and G take H -+ sqrt(H^2 - G).";

/// A sentence each; what curvature is depends on the method, the last on whether the surface was
/// closed at the border.
pub(crate) fn sentences(closed: bool, method: Method) -> Vec<String> {
    let border = if closed {
        "The outside of the image counts as outside the solid: the surface is closed on the border of the image."
    } else {
        "No surfel lies on the border of the image: the surface is open there, and rows whose \
         neighbourhood the border cuts carry the flag `border`."
    };
    let curvature = match method {
        Method::Measures => {
            "H = mu1 / (2 mu0) and G = mu2 / mu0 of the ball; mu1 integrates to twice the integral of H; k1 <= k2."
        }
        Method::Invariants => {
            "H, k1 <= k2 and G = k1 k2 are plain integral invariants: of the volume and covariance of the \
             solid in a ball; they converge only for radii that shrink slower than the gridstep h, such as h^(1/3), \
             and not for radii like h^(1/2)."
        }
    };
    let principal = (method == Method::Measures).then_some(PRINCIPAL);
    [
        "A triple is (x, y, z), x fastest; voxel p covers the unit cube centred at p.",
        "In Khalimsky (doubled) coordinates voxel p is 2p+1; a surfel has exactly one even coordinate.",
        "world = origin + direction * (spacing * index), with voxel (0, 0, 0) centred at the origin.",
        "Normals point outward, from inside to outside.",
        "A convex body has mean curvature H > 0; a sphere of radius R has H = 1/R and G = 1/R^2.",
        curvature,
    ]
    .into_iter()
    .chain(principal)
    .chain([
        "Lengths are in the world unit, areas in its square, H, k1, k2 in its inverse, G in its inverse squared.",
        border,
    ])
    .map(String::from)
    .collect()
}

/// What `curvox --help` says first.
pub(crate) const LONG_ABOUT: &str = "\
Corrected curvature of the boundary of what is in a 3D image, of any size

Reads a volume plane by plane, finds the boundary surfels of the solid in it, and gives each its normal,
mean, Gaussian and principal curvatures by the corrected curvature measures of Lachaud, Romon and
Thibert. Memory is bounded by --memory, not by the size of the image; results are the same bytes
whatever the memory, threads and bricks.";

/// Examples of the whole program.
pub(crate) const EXAMPLES: &str = "\
Examples:
  curvox info --values scan.nii.gz                  what it is, its values, the threshold of Otsu
  curvox plan scan.nii.gz --threshold 300           what a run would take
  curvox run scan.nii.gz --threshold 300 -o out     curvatures, into the directory out
  curvox info out                                   what is there
  curvox shape torus --gridstep 0.1 | curvox run - --threshold 1 -o out";

/// Examples of `curvox run`.
pub(crate) const RUN_EXAMPLES: &str = "\
Examples:
  curvox run scan.nii.gz --threshold 300 -o out
  curvox run scan.nii.gz --threshold 300 --radius auto -o out
  curvox run labels.nii.gz --label 3 --radius 3vx,6vx --directions -o out
  curvox run scan.raw --dims 2048,2048,1500 --dtype u16le --spacing 0.65um --otsu -o out
  curvox run scan.npy --spacing 1,1,2um --range 80..120 --radius 12um --slices every:50 -o out
  curvox run scan.vol --threshold 1 --method paper -o table.parquet
  curvox run scan.nii.gz --threshold 300 --normals gradient --sigma 1.5vx -o out
  curvox run scan.nii.gz --threshold 300 --normals-from normals.parquet -o out
  zcat scan.npy.gz | curvox run - --threshold 0.5 -o - | head";

/// Examples of `curvox noise`.
pub(crate) const NOISE_EXAMPLES: &str = "\
Examples:
  curvox noise scan.nii.gz --threshold 300 --noise 0.3 --seed 7 -o noisy.nii
  curvox noise ball.vol --threshold 1 --noise 0.5 | curvox run - --threshold 1 -o out

Voxels are 1 inside and 0 outside. A .nii carries the voxel size, origin and axes of the input;
.npy, .vol and raw have no place for them.";

/// Examples of `curvox shape`.
pub(crate) const SHAPE_EXAMPLES: &str = "\
Examples:
  curvox shape --list
  curvox shape goursat --gridstep 0.25 | curvox run - --threshold 1 --radius 6vx -o out
  curvox shape sphere:radius=9 --gridstep 0.5,0.5,1 -o ball.nii
  curvox shape torus --gridstep 0.1 --noise 0.3 --seed 7 -o noisy.nii
  curvox shape torus --gridstep 0.1 --partial --blur 1vx --grey-noise 0.05 -o scan.nii

Voxels are 1 inside and 0 outside. The shapes have units of their own, which is no unit of the
world: the volume carries its voxel size without a unit, and radii are typed in voxels.";

/// Examples, conventions, exit codes.
pub(crate) fn long_help(examples: &str) -> String {
    format!("{examples}\n\n{CONVENTIONS_HELP}\n\n{EXIT_HELP}")
}

/// The conventions in brief.
const CONVENTIONS_HELP: &str = "\
Conventions:
  A triple is (x, y, z), x fastest. Voxel p covers the unit cube centred at p.
  Normals point outward. A convex body has H > 0; a sphere of radius R has H = 1/R, G = 1/R^2.
  Curvature is in 1/world-unit, from the voxel size of each axis: voxels need not be cubes.
  The surface is open at the border of the image (--closed closes it); rows near it are flagged.
  Lengths carry a unit: 3vx is 3 voxels (1vx is the longest edge of a voxel), 12um, 0.8mm.
  Flags of a row: border, several_sheets, island, radius_too_large, normal_opposed, lifted,
  degenerate_normal, no_area, rough; their bits are in the metadata of the table and in summary.json.";

/// Exit codes, for every help page and the manual.
pub(crate) const EXIT_HELP: &str = "\
Exit codes:
  0    done (also when the reader of a pipe on standard output went away)
  1    the run failed, or the output could not be written
  2    the command line makes no sense, or asks for what cannot be
  3    the input is damaged, cut short, unreadable or of no known format
  130  interrupted (Ctrl-C or a termination signal); a second Ctrl-C ends at once";
