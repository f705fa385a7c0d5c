//! Half of an image.

/// The means of two by two pixels; an odd row or column at the end is left out.
pub(super) fn reduce(from: &[f32], [width, height]: [usize; 2], to: &mut [f32]) {
    let half = width / 2;
    for (y, out) in to.chunks_exact_mut(half).take(height / 2).enumerate() {
        let (upper, lower) = from[2 * y * width..][..2 * width].split_at(width);
        let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        for (o, (u, l)) in out.iter_mut().zip(pairs) {
            *o = 0.25 * ((u[0] + u[1]) + (l[0] + l[1]));
        }
    }
}
