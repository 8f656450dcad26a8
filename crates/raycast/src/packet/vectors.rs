//! Operations on vectors of three numbers, one vector in each lane.

use super::lanes::Lanes;

#[inline(always)]
pub(super) fn dot<L: Lanes>(l: L, u: [L::F; 3], v: [L::F; 3]) -> L::F {
    l.fma(u[2], v[2], l.fma(u[1], v[1], l.mul(u[0], v[0])))
}

/// Return a vector with the same value in all lanes.
#[inline(always)]
pub(super) fn splat<L: Lanes>(l: L, v: [f32; 3]) -> [L::F; 3] {
    [l.splat(v[0]), l.splat(v[1]), l.splat(v[2])]
}

/// Return a vector times a number, `t v`.
#[inline(always)]
pub(super) fn scaled<L: Lanes>(l: L, t: L::F, v: [L::F; 3]) -> [L::F; 3] {
    [l.mul(v[0], t), l.mul(v[1], t), l.mul(v[2], t)]
}

/// Return a matrix times a vector, `rows . v`.
#[inline(always)]
pub(super) fn turn<L: Lanes>(l: L, rows: &[[f32; 3]; 3], v: [L::F; 3]) -> [L::F; 3] {
    let mut out = v;
    for x in 0..3 {
        out[x] = dot(l, splat(l, rows[x]), v);
    }
    out
}

/// Return a point moved along a vector, `p + t v`.
#[inline(always)]
pub(super) fn along<L: Lanes>(l: L, p: [L::F; 3], t: L::F, v: [L::F; 3]) -> [L::F; 3] {
    let mut out = p;
    for a in 0..3 {
        out[a] = l.fma(t, v[a], p[a]);
    }
    out
}

/// Return the unit vector and the length of a vector; the unit vector is undefined for length 0.
#[inline(always)]
pub(super) fn unit<L: Lanes>(l: L, v: [L::F; 3]) -> ([L::F; 3], L::F) {
    let length = l.sqrt(dot(l, v, v));
    let inverse = l.div(l.splat(1.0), l.max(length, l.splat(1e-12)));
    (scaled(l, inverse, v), length)
}

/// Return a smooth step of `t`: 0 below 0, 1 above 1.
#[inline(always)]
pub(super) fn smooth<L: Lanes>(l: L, t: L::F) -> L::F {
    let t = l.min(l.max(t, l.splat(0.0)), l.splat(1.0));
    l.mul(l.mul(t, t), l.fma(t, l.splat(-2.0), l.splat(3.0)))
}
