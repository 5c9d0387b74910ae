//! Trajectory files: TUM (`t tx ty tz qx qy qz qw`), KITTI (twelve numbers of the upper 3×4 matrix, row by row) and EuRoC's
//! ground truth (`data.csv` of 17 columns), told apart by their columns; and lists of frame times.

use crate::{EvalError, Pose, Trajectory};
use geometry::Se3;
use nalgebra::{Matrix3, Vector3};
use std::path::Path;

/// How far a quaternion's length may be from one, and a matrix from a rotation: files round their digits.
const UNIT_TOLERANCE: f64 = 1e-2;

/// Columns of EuRoC's `state_groundtruth_estimate0/data.csv`: nanoseconds, position, quaternion (w first), velocity, biases.
const EUROC_COLUMNS: usize = 17;

/// Reads a trajectory in TUM or KITTI form, or EuRoC's ground truth, whose poses are those of the body (`world_from_body`;
/// [`Trajectory::seen_from`] gives those of its camera). Lines that start with `#` are comments; numbers are separated
/// by spaces, tabs or commas. Numbers that are not finite, poses that are not rigid and times that do
/// not grow are refused with file and line.
pub fn read_trajectory(path: &Path) -> Result<Trajectory, EvalError> {
    let text = read_text(path)?;
    let mut timestamps = Vec::new();
    let mut world_from_camera = Vec::new();
    let mut columns = None;
    for (line, content) in content_lines(&text) {
        let fail = |problem: String| EvalError::Line { path: path.to_owned(), line, problem };
        let values = numbers(content).map_err(fail)?;
        let expected = *columns.get_or_insert(values.len());
        if values.len() != expected {
            return Err(fail(format!("has {} numbers, the lines before have {expected}", values.len())));
        }
        match values.as_slice() {
            &[t, x, y, z, qx, qy, qz, qw] => {
                if timestamps.last().is_some_and(|&last| t <= last) {
                    return Err(fail(format!("time {t} does not grow: sort the file and drop duplicates")));
                }
                timestamps.push(t);
                world_from_camera.push(tum_pose([x, y, z, qx, qy, qz, qw]).map_err(fail)?);
            }
            &[ns, x, y, z, qw, qx, qy, qz, ..] if values.len() == EUROC_COLUMNS => {
                let t = ns * 1e-9;
                if timestamps.last().is_some_and(|&last| t <= last) {
                    return Err(fail(format!("time {ns} does not grow: sort the file and drop duplicates")));
                }
                timestamps.push(t);
                world_from_camera.push(tum_pose([x, y, z, qx, qy, qz, qw]).map_err(fail)?);
            }
            v if v.len() == 12 => world_from_camera.push(kitti_pose(v).map_err(fail)?),
            v => {
                return Err(fail(format!(
                    "has {} numbers: expected 8 (TUM: t tx ty tz qx qy qz qw), 12 (KITTI: 3×4 matrix) or 17 \
                     (EuRoC's state_groundtruth_estimate0/data.csv)",
                    v.len()
                )));
            }
        }
    }
    if world_from_camera.is_empty() {
        return Err(EvalError::Empty { path: path.to_owned(), what: "pose" });
    }
    let timestamps = (!timestamps.is_empty()).then_some(timestamps);
    Ok(Trajectory { timestamps, world_from_camera })
}

/// Reads the first column of a frame list such as `times.txt`: seconds, one line per frame, strictly growing.
pub fn read_times(path: &Path) -> Result<Vec<f64>, EvalError> {
    let text = read_text(path)?;
    let mut times: Vec<f64> = Vec::new();
    for (line, content) in content_lines(&text) {
        let fail = |problem: String| EvalError::Line { path: path.to_owned(), line, problem };
        let first = fields(content).next().ok_or_else(|| fail("has no time".into()))?;
        let time = numbers(first).map_err(fail)?[0];
        if times.last().is_some_and(|&last| time <= last) {
            return Err(fail(format!("time {time} does not grow: sort the file and drop duplicates")));
        }
        times.push(time);
    }
    if times.is_empty() {
        return Err(EvalError::Empty { path: path.to_owned(), what: "time" });
    }
    Ok(times)
}

fn read_text(path: &Path) -> Result<String, EvalError> {
    std::fs::read_to_string(path).map_err(|source| EvalError::Read { path: path.to_owned(), source })
}

/// The lines that carry something, with their numbers from 1.
fn content_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

fn fields(line: &str) -> impl Iterator<Item = &str> {
    line.split([' ', '\t', ',']).filter(|field| !field.is_empty())
}

fn numbers(line: &str) -> Result<Vec<f64>, String> {
    fields(line)
        .map(|field| match field.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) => Err(format!("`{field}` is not finite: drop poses that are not known")),
            Err(_) => Err(format!("`{field}` is not a number")),
        })
        .collect()
}

fn tum_pose(values: [f64; 7]) -> Result<Pose, String> {
    let norm = values[3..].iter().map(|q| q * q).sum::<f64>().sqrt();
    if (norm - 1.0).abs() > UNIT_TOLERANCE {
        return Err(format!("quaternion has length {norm}, expected 1 (order qx qy qz qw)"));
    }
    Ok(Se3::from_tum(values).into())
}

fn kitti_pose(v: &[f64]) -> Result<Pose, String> {
    let rotation = Matrix3::new(v[0], v[1], v[2], v[4], v[5], v[6], v[8], v[9], v[10]);
    let error = (rotation.transpose() * rotation - Matrix3::identity()).abs().max();
    if error > UNIT_TOLERANCE || rotation.determinant() < 0.0 {
        return Err("the left 3×3 of the matrix is not a rotation".to_owned());
    }
    Ok(Pose { rotation, translation: Vector3::new(v[3], v[7], v[11]) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn file(text: &str) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        file
    }

    fn problem(text: &str) -> String {
        let file = file(text);
        let message = read_trajectory(file.path()).unwrap_err().to_string();
        message.replace(&file.path().display().to_string(), "FILE")
    }

    #[test]
    fn tum_and_kitti_describe_one_pose() {
        let s = 0.5f64.sqrt();
        let tum = file(&format!("# comment\n\n1.5 1 2 3 0 0 {s} {s}\n"));
        let kitti = file("0 -1 0 1 1 0 0 2 0 0 1 3\n");
        let tum = read_trajectory(tum.path()).unwrap();
        let kitti = read_trajectory(kitti.path()).unwrap();
        assert_eq!(tum.timestamps, Some(vec![1.5]));
        assert_eq!(kitti.timestamps, None);
        let (tum, kitti) = (tum.world_from_camera[0], kitti.world_from_camera[0]);
        assert!((tum.rotation - kitti.rotation).norm() < 1e-15);
        assert_eq!(tum.translation, kitti.translation);
    }

    #[test]
    fn euroc_truth_is_that_of_the_camera_on_the_body() {
        let s = 0.5f64.sqrt();
        let rest = "0,0,0,0,0,0,0,0,0";
        let truth = file(&format!(
            "#timestamp [ns], p_RS_R_x [m]\n1403636580838555648,1,2,3,{s},0,0,{s},{rest}\n1403636580843555328,1,2,4,1,0,0,0,{rest}\n"
        ));
        let body = read_trajectory(truth.path()).unwrap();
        assert!((body.timestamps.as_ref().unwrap()[0] - 1_403_636_580.838_555_6).abs() < 1e-6);
        assert_eq!(body.world_from_camera[0].translation, Vector3::new(1.0, 2.0, 3.0));
        // The camera is 10 cm along the body's x, which the quarter turn about z makes the world's y.
        let body_from_camera = Se3::new(nalgebra::UnitQuaternion::identity(), Vector3::new(0.1, 0.0, 0.0));
        let camera = body.seen_from(&body_from_camera);
        assert!((camera.world_from_camera[0].translation - Vector3::new(1.0, 2.1, 3.0)).norm() < 1e-12);
        assert!((camera.world_from_camera[1].translation - Vector3::new(1.1, 2.0, 4.0)).norm() < 1e-12);
    }

    #[test]
    fn errors_name_file_and_line() {
        let good = "1 0 0 0 0 0 0 1\n";
        assert_eq!(
            problem(&format!("{good}2 0 NaN 0 0 0 0 1")),
            "FILE:2: `NaN` is not finite: drop poses that are not known"
        );
        assert_eq!(problem("# c\n1 0 x 0 0 0 0 1"), "FILE:2: `x` is not a number");
        assert_eq!(
            problem(&format!("{good}{good}")),
            "FILE:2: time 1 does not grow: sort the file and drop duplicates"
        );
        assert_eq!(problem(&format!("{good}1 2 3")), "FILE:2: has 3 numbers, the lines before have 8");
        assert!(problem("1 2 3").starts_with("FILE:1: has 3 numbers: expected 8"));
        assert!(problem("1 0 0 0 0 0 0 0").starts_with("FILE:1: quaternion has length 0"));
        assert!(problem("1 0 0 0 0 1 0 0 0 0 -1 0").ends_with("is not a rotation"));
        assert!(problem("# nothing\n").contains("holds no pose"));
        assert!(read_trajectory(Path::new("/none/such")).unwrap_err().to_string().starts_with("/none/such:"));
    }

    #[test]
    fn times_are_the_first_column() {
        let list = file("# timestamp image\n0.0 images/0.jpg\n0.1,images/1.jpg\n");
        assert_eq!(read_times(list.path()).unwrap(), [0.0, 0.1]);
        assert!(read_times(file("0.1\n0.1\n").path()).unwrap_err().to_string().contains(":2: time 0.1"));
        assert!(read_times(file("images/0.jpg\n").path()).is_err());
        assert!(read_times(file("0.1\n,\n").path()).unwrap_err().to_string().contains(":2: has no time"));
    }
}
