//! The conventions in words: in the metadata of every table, in `summary.json`, and in `--help`.

/// A sentence each; the last depends on whether the surface was closed at the border.
pub(crate) fn sentences(closed: bool) -> Vec<String> {
    let border = if closed {
        "The outside of the image counts as outside the solid: the surface is closed on the border of the image."
    } else {
        "No surfel lies on the border of the image: the surface is open there, and rows whose \
         neighbourhood the border cuts carry the flag `border`."
    };
    [
        "A triple is (x, y, z), x fastest; voxel p covers the unit cube centred at p.",
        "In Khalimsky (doubled) coordinates voxel p is 2p+1; a surfel has exactly one even coordinate.",
        "world = origin + direction * (spacing * index), with voxel (0, 0, 0) centred at the origin.",
        "Normals point outward, from inside to outside.",
        "A convex body has mean curvature H > 0; a sphere of radius R has H = 1/R and G = 1/R^2.",
        "H = mu1 / (2 mu0) and G = mu2 / mu0 of the ball; mu1 integrates to twice the integral of H; k1 <= k2.",
        "Lengths are in the world unit, areas in its square, H, k1, k2 in its inverse, G in its inverse squared.",
        border,
    ]
    .map(String::from)
    .to_vec()
}

/// The end of `curvox --help` and `curvox run --help`.
pub(crate) const CONVENTIONS_HELP: &str = "\
Conventions:
  A triple is (x, y, z), x fastest. Voxel p covers the unit cube centred at p.
  Normals point outward. A convex body has H > 0; a sphere of radius R has H = 1/R, G = 1/R^2.
  Curvature is in 1/world-unit, from the voxel size of each axis: voxels need not be cubes.
  The surface is open at the border of the image (--closed closes it); rows near it are flagged.
  Lengths carry a unit: 3vx is 3 voxels (1vx is the longest edge of a voxel), 12um, 0.8mm.
  Flags of a row: border, several_sheets, island, radius_too_large, normal_opposed, lifted,
  degenerate_normal, no_area; their bits are in the metadata of the table and in summary.json.";

/// Exit codes, for every help page and the manual.
pub(crate) const EXIT_HELP: &str = "\
Exit codes:
  0    done (also when the reader of a pipe on standard output went away)
  1    the run failed, or the output could not be written
  2    the command line makes no sense
  3    the input is damaged, cut short, unreadable or of no known format
  130  interrupted (Ctrl-C or a termination signal); a second Ctrl-C ends at once";
