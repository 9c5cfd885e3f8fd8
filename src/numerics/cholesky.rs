//! Cholesky factors of small symmetric positive definite matrices.

/// A square matrix, row by row.
pub(crate) type Matrix<const N: usize> = [[f64; N]; N];

/// The lower triangle `L` of `A = L Lᵀ`. Only the lower triangle of `A` is read; `None` where `A` is not positive
/// definite.
pub(crate) fn cholesky<const N: usize>(a: &Matrix<N>) -> Option<Matrix<N>> {
    let mut l = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let rest = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            if i != j {
                l[i][j] = rest / l[j][j];
            } else if rest.is_finite() && rest > 0.0 {
                l[i][i] = rest.sqrt();
            } else {
                return None;
            }
        }
    }
    Some(l)
}

/// Solves `L x = b`.
pub(crate) fn forward<const N: usize>(l: &Matrix<N>, mut b: [f64; N]) -> [f64; N] {
    for i in 0..N {
        b[i] = (b[i] - (0..i).map(|k| l[i][k] * b[k]).sum::<f64>()) / l[i][i];
    }
    b
}

/// Solves `Lᵀ x = b`.
pub(crate) fn backward<const N: usize>(l: &Matrix<N>, mut b: [f64; N]) -> [f64; N] {
    for i in (0..N).rev() {
        b[i] = (b[i] - (i + 1..N).map(|k| l[k][i] * b[k]).sum::<f64>()) / l[i][i];
    }
    b
}

/// Solves `L Lᵀ x = b`.
pub(crate) fn solve<const N: usize>(l: &Matrix<N>, b: [f64; N]) -> [f64; N] {
    backward(l, forward(l, b))
}

/// Column `i` of `(L Lᵀ)⁻¹`.
pub(crate) fn inverse_column<const N: usize>(l: &Matrix<N>, i: usize) -> [f64; N] {
    let mut unit = [0.0; N];
    unit[i] = 1.0;
    solve(l, unit)
}

/// The scalar product.
pub(crate) fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_system_is_solved() {
        let a = [[4.0, 0.0, 0.0], [2.0, 5.0, 0.0], [-1.0, 1.0, 3.0]];
        let l = cholesky(&a).unwrap();
        let x = solve(&l, [5.0, 8.0, 3.0]);
        // By hand: the full matrix is [4 2 -1; 2 5 1; -1 1 3].
        assert!(x.iter().all(|x| (x - 1.0).abs() < 1e-12), "{x:?}");
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        assert_eq!(cholesky(&[[1.0, 0.0], [2.0, 1.0]]), None);
        assert_eq!(cholesky(&[[f64::NAN]]), None);
    }
}
