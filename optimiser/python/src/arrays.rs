//! NumPy's arrays as the simulator's lists, and back.

use nalgebra::{Quaternion, UnitQuaternion};
use numpy::{
    AllowTypeChange, Element, IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayLikeDyn, PyArrayMethods,
    ndarray::{ArrayView1, Ix1, Ix2},
};
use powderline_shared::{
    displacement::Displacement,
    pose::{Pose, renormalised},
};
use powderline_simulator::{
    scene::{Scene, figures::about},
    skill::{Theta, ThetaError},
};
use pyo3::{
    exceptions::{PyTypeError, PyValueError},
    prelude::*,
    types::{PyList, PyString, PyTuple},
};

use crate::errors::{self, SkillError};
use crate::given;

/// A list or an array of numbers, of whatever shape: what would be right is said here, not by NumPy.
pub(crate) type Numbers<'py> = Bound<'py, PyAny>;

/// A list of lists, or a table.
pub(crate) type Table<'py> = Numbers<'py>;

/// As Python writes it.
fn shown(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        more => format!("({})", more.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")),
    }
}

fn refused<T>(what: &str, shape: &str, found: &[usize]) -> PyResult<T> {
    let found = shown(found);
    Err(PyValueError::new_err(format!("{what} has the shape {found}, but it must be {shape}")))
}

/// The numbers that were given. NumPy would read some from words, too.
fn numbers<'py>(
    what: &str,
    shape: &str,
    given: &Numbers<'py>,
) -> PyResult<PyArrayLikeDyn<'py, f64, AllowTypeChange>> {
    let kind = || given.getattr("dtype")?.getattr("kind")?.extract::<String>();
    let read = match kind() {
        Ok(kind) if !"biuf".contains(&kind) => None,
        _ if is_none_or_word(given) => None,
        _ => given.extract().ok(),
    };
    let wrong = || format!("{what} is {}, but it must be numbers of the shape {shape}", given::shown(given));
    read.ok_or_else(|| PyTypeError::new_err(wrong()))
}

/// Whether it is a word or nothing at all, or one is in a list, or in one of its lists.
fn is_none_or_word(given: &Bound<'_, PyAny>) -> bool {
    if given.is_none() || given.is_instance_of::<PyString>() {
        return true;
    }
    let is_list = given.is_instance_of::<PyList>() || given.is_instance_of::<PyTuple>();
    is_list
        && given
            .try_iter()
            .is_ok_and(|mut items| items.any(|item| item.is_ok_and(|item| is_none_or_word(&item))))
}

fn fixed<const N: usize>(row: ArrayView1<'_, f64>) -> [f64; N] {
    std::array::from_fn(|k| row[k])
}

/// `N` numbers.
pub(crate) fn row<const N: usize>(what: &str, numbers: &Numbers<'_>) -> PyResult<[f64; N]> {
    let shape = format!("({N},)");
    let numbers = self::numbers(what, &shape, numbers)?;
    match numbers.as_array().into_dimensionality::<Ix1>() {
        Ok(row) if row.len() == N => Ok(fixed(row)),
        _ => refused(what, &shape, numbers.as_array().shape()),
    }
}

/// A skill.
pub(crate) fn theta(numbers: &Numbers<'_>) -> PyResult<Theta> {
    Theta::new(row("theta", numbers)?).map_err(errors::of_theta)
}

/// Rows of `N` numbers.
pub(crate) fn rows<const N: usize>(what: &str, table: &Table<'_>) -> PyResult<Vec<[f64; N]>> {
    let wanted = format!("(n, {N})");
    let numbers = numbers(what, &wanted, table)?;
    let table = numbers.as_array();
    // Nothing at all has no width.
    if table.shape()[..] == [0] {
        return Ok(Vec::new());
    }
    let shape = table.shape().to_vec();
    match table.into_dimensionality::<Ix2>() {
        Ok(table) if table.ncols() == N => Ok(table.rows().into_iter().map(fixed).collect()),
        _ => refused(what, &wanted, &shape),
    }
}

/// Skills.
pub(crate) fn thetas(table: &Table<'_>) -> PyResult<Vec<Theta>> {
    let named = |(index, row)| {
        Theta::new(row).map_err(|error| {
            let ThetaError { parameter, value, .. } = error;
            SkillError::new_err(format!(
                "thetas[{index}, {}] ({}) is {value}, outside [-1, 1]",
                parameter.index(),
                parameter.name()
            ))
        })
    };
    rows::<5>("thetas", table)?.into_iter().enumerate().map(named).collect()
}

/// Displacements, one for each control step: translation in metres, then rotation vector in radians.
pub(crate) fn displacements(what: &str, table: &Table<'_>) -> PyResult<Vec<Displacement>> {
    let rows = rows::<6>(what, table)?;
    match rows.iter().flatten().position(|number| !number.is_finite()) {
        None => Ok(rows.into_iter().map(Displacement::from).collect()),
        Some(at) => Err(PyValueError::new_err(format!(
            "{what}[{}, {}] is {}, but displacements are finite",
            at / 6,
            at % 6,
            rows[at / 6][at % 6]
        ))),
    }
}

/// Refuses a motion that leaves the simulated volume, where there is neither powder nor anything to move it: as a rule somebody has
/// given millimetres.
pub(crate) fn within(scene: &Scene, from: &Pose, controls: &[Displacement]) -> PyResult<()> {
    let size_m = scene.domain.size_m;
    // Where a pose is, and what it is out of; nothing where it is within.
    let out = |pose: &Pose| {
        let at_m: [f64; 3] = pose.position_m.into();
        let list = |metres: [f64; 3]| metres.map(|x| about(x, 4)).join(", ");
        (0..3).any(|axis| !(0.0..=size_m[axis]).contains(&at_m[axis])).then(|| {
            format!("[{}], out of the simulated volume from [0, 0, 0] to [{}]", list(at_m), list(size_m))
        })
    };
    if let Some(where_to) = out(from) {
        return Err(PyValueError::new_err(format!("the tool begins at {where_to}: positions are metres")));
    }
    let mut pose = *from;
    for (step, control) in controls.iter().enumerate() {
        pose = pose.displaced(control);
        if let Some(where_to) = out(&pose) {
            return Err(PyValueError::new_err(format!(
                "displacements[{step}] takes the tool to {where_to}: displacements are metres and radians from one control step to the next"
            )));
        }
    }
    Ok(())
}

/// A pose from x, y, z in metres and a unit quaternion w, x, y, z.
pub(crate) fn pose(what: &str, numbers: &Numbers<'_>) -> PyResult<Pose> {
    let [x, y, z, qw, qx, qy, qz] = row::<7>(what, numbers)?;
    let orientation = Quaternion::new(qw, qx, qy, qz);
    let norm = orientation.norm();
    if !(x + y + z).is_finite() || (norm - 1.0).abs() > 1e-6 || norm.is_nan() {
        return Err(PyValueError::new_err(format!(
            "{what} is [{x}, {y}, {z}, {qw}, {qx}, {qy}, {qz}], whose last four have the norm {norm}, but it must be x, y, z in \
             metres and a unit quaternion w, x, y, z"
        )));
    }
    let orientation = renormalised(UnitQuaternion::new_unchecked(orientation));
    Ok(Pose { position_m: [x, y, z].into(), orientation })
}

/// x, y, z, qw, qx, qy, qz.
pub(crate) fn of_pose(pose: &Pose) -> [f64; 7] {
    let (p, q) = (pose.position_m, pose.orientation);
    [p.x, p.y, p.z, q.w, q.i, q.j, q.k]
}

/// A row as an array.
pub(crate) fn array<'py>(py: Python<'py>, row: &[f64]) -> Bound<'py, PyArray1<f64>> {
    PyArray1::from_slice(py, row)
}

/// Rows as a table; the memory goes over to Python.
pub(crate) fn table<'py, T: Element, const N: usize>(
    py: Python<'py>,
    rows: Vec<[T; N]>,
) -> Bound<'py, PyArray2<T>> {
    let count = rows.len();
    let flat = rows.into_flattened().into_pyarray(py);
    flat.reshape([count, N]).expect("as many numbers as before")
}

/// Frames of rows as an array of three dimensions; the memory goes over to Python.
pub(crate) fn frames<'py>(py: Python<'py>, rows: Vec<[f32; 3]>, frames: usize) -> Bound<'py, PyArray3<f32>> {
    let each = rows.len().checked_div(frames).unwrap_or(0);
    let flat = rows.into_flattened().into_pyarray(py);
    flat.reshape([frames, each, 3]).expect("as many numbers as before")
}
