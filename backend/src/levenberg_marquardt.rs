//! Levenberg–Marquardt over few unknowns (Marquardt 1963): the loop, for problems that know their own step and cost.

/// How steps are damped, and when to end.
#[derive(Clone, Copy, Debug)]
pub struct Descent {
    /// Steps that are tried at the most.
    pub iterations: usize,
    /// The cost falls by a smaller share: done.
    pub min_decrease: f64,
    /// The damping of the first step.
    pub damping: f64,
    /// Factor on the damping after a step that lowers the cost, and the least that it becomes.
    pub eased: (f64, f64),
    /// Factor on the damping after another step, and the least that it becomes.
    pub raised: (f64, f64),
    /// Damping beyond which no step is tried.
    pub most: f64,
}

impl Descent {
    /// Descends from a state and its linearisation; gives those at which the cost is lowest.
    ///
    /// `step` takes a damped step and gives the state there; where there is none, it ends. `linearise` gives the normal equations of a
    /// state; nothing where it must not go.
    pub fn minimise<State, Normal>(
        &self,
        (mut state, mut normal): (State, Normal),
        mut step: impl FnMut(&State, &Normal, f64) -> Option<State>,
        linearise: impl Fn(&State) -> Option<Normal>,
        cost: impl Fn(&Normal) -> f64,
    ) -> (State, Normal) {
        let mut damping = self.damping;
        for _ in 0..self.iterations {
            let Some(moved) = step(&state, &normal, damping) else { break };
            let before = cost(&normal);
            match linearise(&moved).filter(|next| cost(next) < before) {
                Some(next) => {
                    let decrease = before - cost(&next);
                    (state, normal) = (moved, next);
                    damping = (damping * self.eased.0).max(self.eased.1);
                    if decrease < self.min_decrease * before {
                        break;
                    }
                }
                None => {
                    damping = (damping * self.raised.0).max(self.raised.1);
                    if damping > self.most {
                        break;
                    }
                }
            }
        }
        (state, normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The minimum of Rosenbrock's valley `(1 − x)² + 100 (y − x²)²` and its residuals there.
    fn found(descent: &Descent) -> ([f64; 2], f64) {
        let residuals = |&[x, y]: &[f64; 2]| [1.0 - x, 10.0 * (y - x * x)];
        let linearise = |at: &[f64; 2]| Some((*at, residuals(at)));
        let step = |_: &[f64; 2], (at, [r, s]): &([f64; 2], [f64; 2]), damping: f64| {
            // Jᵀ J and Jᵀ r with J = [[−1, 0], [−20 x, 10]].
            let by_x = -20.0 * at[0];
            let (a, b, c) = ((1.0 + by_x * by_x) * (1.0 + damping), 10.0 * by_x, 100.0 * (1.0 + damping));
            let (g, h) = (-r + by_x * s, 10.0 * s);
            let determinant = a * c - b * b;
            (determinant > 0.0)
                .then(|| [at[0] - (c * g - b * h) / determinant, at[1] - (a * h - b * g) / determinant])
        };
        let cost = |(_, [r, s]): &([f64; 2], [f64; 2])| r * r + s * s;
        let start = [-1.2, 1.0];
        let (state, normal) = descent.minimise((start, (start, residuals(&start))), step, linearise, cost);
        (state, cost(&normal))
    }

    #[test]
    fn a_bent_valley_is_followed_to_its_lowest_place() {
        let descent = Descent {
            iterations: 100,
            min_decrease: 1e-12,
            damping: 1e-3,
            eased: (0.2, 1e-9),
            raised: (10.0, 1e-6),
            most: 1e8,
        };
        let ([x, y], cost) = found(&descent);
        assert!((x - 1.0).abs() < 1e-6 && (y - 1.0).abs() < 1e-6 && cost < 1e-12, "{x} {y} {cost}");
        let (_, some) = found(&Descent { iterations: 3, ..descent });
        assert!(some < 24.2 && some > cost, "a step never raises the cost: {some}");
    }
}
