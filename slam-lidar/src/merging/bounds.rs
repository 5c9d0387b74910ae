//! What a pose must show beside the likelihood.

/// Pieces that must come back to the pose: one can be deceived.
pub const PIECES: usize = 2;
/// Least overlap: what is asked of pairs of maps.
pub const OVERLAP: f64 = 0.3;
/// Least share of what both saw that is there in both: of one place with half of its things moved it is 0.95, of doubles with
/// nothing but the plan in common 0.84 and more. Beside another place by a repetition, or in another, it is less.
pub const INLIER_RATIO: f64 = 0.82;
/// Share of what both saw that is there in both at a glimpse, where a pose is looked at closely: of one place with half of its things
/// moved it is 0.95, of doubles with nothing but the plan in common 0.84 and more.
pub const GLIMPSED: f64 = 0.7;
/// Least such share of a refused pose that fits as well as one that passes: that of one place with half of its things moved. Beside the
/// right pose of rendered stretches, repetitions at which more is alike, since they overlap more, agree by 0.93 and less.
pub const AS_WELL: f64 = 0.95;
/// Largest thing that is not there in the other map where the likelihood does not tell, square metres: two cells. Since maps
/// begin level three of 382 right poses of rendered sites leave more; floors of one plan and sites shifted by a repetition
/// that share as much as is asked leave 0.19 and more where this was set.
pub const ABSENT: f64 = 0.125;
/// And so large a share of what both saw beyond [`MUCH`]: one cart that was moved is 0.0006 of what two drives through a hall
/// saw, and of what repeats none was accepted by this.
pub const ABSENT_SHARE: f64 = 0.00075;
/// What stretches of some metres share on the median, square metres.
pub const MUCH: f64 = 400.0;
/// Least surface that both saw where the likelihood does not tell, square metres, where it is less than [`MOST`] of what each
/// saw: a few doors of a corridor look like those of the next. Sites that repeat themselves agreed without a contradiction on
/// up to 176 m².
pub const SHARED: f64 = 200.0;
/// From this overlap on the maps are of one place or of its double, however small it is: what agreed without a contradiction
/// overlapped by up to 0.56.
pub const MOST: f64 = 0.7;
