//! Least squares with unknowns that cannot be negative.

/// Largest number of sweeps over the unknowns, and the relative change below which they end.
const MAX_SWEEPS: usize = 20_000;
const ENOUGH: f64 = 1e-10;

/// The x ≥ 0 that minimises `|Σ xᵢ columnᵢ - y|²`, by coordinate descent, and that minimum. A column of zeros gets 0.
pub(crate) fn nonnegative_least_squares(columns: &[&[f64]], y: &[f64]) -> (Vec<f64>, f64) {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let gram: Vec<Vec<f64>> = columns.iter().map(|a| columns.iter().map(|b| dot(a, b)).collect()).collect();
    let right: Vec<f64> = columns.iter().map(|a| dot(a, y)).collect();
    let mut x = vec![0.0; columns.len()];
    for _ in 0..MAX_SWEEPS {
        let mut change: f64 = 0.0;
        for i in 0..x.len() {
            if gram[i][i] > 0.0 {
                let gradient = right[i] - dot(&gram[i], &x);
                let new = f64::max(0.0, x[i] + gradient / gram[i][i]);
                change = change.max((new - x[i]).abs() / new.max(x[i]).max(f64::MIN_POSITIVE));
                x[i] = new;
            }
        }
        if change < ENOUGH {
            break;
        }
    }
    let misfit = |k: usize| y[k] - columns.iter().zip(&x).map(|(c, x)| c[k] * x).sum::<f64>();
    let square = (0..y.len()).map(|k| misfit(k).powi(2)).sum();
    (x, square)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_negative_unknown_is_zero_and_the_others_make_the_best_of_it() {
        let (a, b) = ([1.0, 1.0, 0.0], [0.0, 1.0, 1.0]);
        let (x, square) = nonnegative_least_squares(&[&a, &b], &[2.0, 5.0, 3.0]);
        assert!((x[0] - 2.0).abs() < 1e-8 && (x[1] - 3.0).abs() < 1e-8 && square < 1e-12, "{x:?} {square}");
        let (x, square) = nonnegative_least_squares(&[&a, &b], &[2.0, 1.0, -1.0]);
        assert_eq!(x[1], 0.0);
        assert!((x[0] - 1.5).abs() < 1e-8 && (square - 1.5).abs() < 1e-8, "{x:?} {square}");
        assert_eq!(nonnegative_least_squares(&[&[0.0; 3]], &[1.0; 3]), (vec![0.0], 3.0));
    }
}
