//! Corrected curvature measures: what each cell carries, and sums over balls.
//!
//! Comes in: surfels with their links and normals `u`. Goes out: mu0 on surfels, mu1 (as a tensor
//! whose trace it is) on linels, mu2 on pointels ([`evaluate()`], [`cells`]), and their sums over the part of the
//! surface in a ball ([`ball`]); on request also mu_Omega, which is zero for the normals of a surface. With
//! a field that is continuous ([`field::Field`]) all measures lie on surfels. The formulas alone,
//! without any surface, are in [`formula`] and [`patch`].
//!
//! Paper: Lachaud, Romon, Thibert, *Corrected curvature measures*, Proposition 3.8 (constant `u`
//! per face), Example 2.4 and Proposition 3.5 (continuous `u`); the tensor follows Remark 3.7.
//!
//! Guaranteed: every measure of a cell is rounded once, to an integer ([`fixed`]), so sums are
//! exact and do not depend on their order; the integer Gauss-Bonnet identity
//! `sum(mu2) + 4 pi sum(k) = 2 pi (V - E + F)` holds on every closed surface for every `u` of unit length (not for a linear field).
//! Not guaranteed: that a measure of a small set means anything by itself.

pub mod ball;
pub mod cells;
pub mod constant;
pub mod continuous;
mod evaluate;
pub mod field;
pub mod fixed;
pub mod formula;
mod grouped;
mod linels;
mod local;
pub(crate) mod mixture;
pub mod patch;
pub mod surface;

pub use evaluate::evaluate;
