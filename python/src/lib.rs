//! The native part of the Python package `lumenmesh`: arrays in, arrays out. What Python users see is in
//! `lumenmesh/_api.py`, which checks shapes and types.

use lumenmesh_core::evaluate::{Truth, evaluate as evaluate_surface};
use lumenmesh_core::glam::{DVec2, DVec3};
use lumenmesh_core::reconstruction::{
    Change as CoreChange, Live as CoreLive, Lumen, Progress, Reconstructor,
};
use lumenmesh_core::recording::{CylinderModel, Frame, Recording as CoreRecording};
use lumenmesh_core::report::render::{Style, render};
use lumenmesh_core::settings::Settings;
use lumenmesh_core::simulate::{Noise, Phantom, Probe, Shape, Simulation, SimulationSettings};
use lumenmesh_core::surface::{NodeArray, Space, Surface};
use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::create_exception;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError, mpsc};
use std::time::Duration;

create_exception!(
    lumenmesh,
    Error,
    PyValueError,
    "What cannot be used: frame, field, what was found and what was expected."
);

fn error(error: lumenmesh_core::Error) -> PyErr {
    Error::new_err(error.to_string())
}

/// Settings by name and value, as the TOML file writes them.
fn settings_of(named: &[(String, String)]) -> PyResult<Settings> {
    let mut settings = Settings::default();
    for (name, value) in named {
        settings.set(name, value).map_err(error)?;
    }
    Ok(settings)
}

fn json(value: impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(&value).map_err(|e| Error::new_err(e.to_string()))
}

fn matrix(numbers: &[f64]) -> [[f64; 4]; 4] {
    std::array::from_fn(|r| std::array::from_fn(|c| numbers[4 * r + c]))
}

/// Points of a contiguous array (M, 2).
fn contour(points: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<DVec2>> {
    Ok(points.as_slice()?.as_chunks::<2>().0.iter().copied().map(DVec2::from_array).collect())
}

/// What the probe saw.
#[pyclass(frozen, module = "lumenmesh._lumenmesh")]
struct NativeRecording(CoreRecording);

impl NativeRecording {
    /// A number of each frame, NaN where it has none; `None` where no frame has it.
    fn of_frames<'py>(
        &self,
        py: Python<'py>,
        of: impl Fn(&Frame) -> Option<f64>,
    ) -> Option<Bound<'py, PyArray1<f64>>> {
        let numbers: Vec<Option<f64>> = self.0.frames.iter().map(of).collect();
        let all = || numbers.iter().map(|number| number.unwrap_or(f64::NAN));
        numbers.iter().any(Option::is_some).then(|| Array1::from_iter(all()).into_pyarray(py))
    }
}

#[pymethods]
impl NativeRecording {
    #[new]
    fn new(
        poses: PyReadonlyArray3<'_, f64>,
        contours: Vec<PyReadonlyArray2<'_, f64>>,
        time: Option<PyReadonlyArray1<'_, f64>>,
        cylinders: Option<PyReadonlyArray2<'_, f64>>,
        phase: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Self> {
        let matrices: Vec<[[f64; 4]; 4]> = poses.as_slice()?.chunks_exact(16).map(matrix).collect();
        let contours: Vec<Vec<DVec2>> = contours.iter().map(contour).collect::<PyResult<_>>()?;
        let mut recording = CoreRecording::from_matrices(&matrices, contours).map_err(error)?;
        if let Some(time) = time {
            for (frame, &time_s) in recording.frames.iter_mut().zip(time.as_slice()?) {
                frame.time_s = Some(time_s).filter(|t| !t.is_nan());
            }
        }
        if let Some(phase) = phase {
            for (frame, &phase) in recording.frames.iter_mut().zip(phase.as_slice()?) {
                frame.phase = Some(phase).filter(|phase| !phase.is_nan());
            }
        }
        if let Some(cylinders) = cylinders {
            for (frame, numbers) in recording.frames.iter_mut().zip(cylinders.as_slice()?.chunks_exact(5)) {
                let [px_mm, py_mm, theta_rad, phi_rad, radius_mm] = numbers else { continue };
                let model = CylinderModel {
                    px_mm: *px_mm,
                    py_mm: *py_mm,
                    theta_rad: *theta_rad,
                    phi_rad: *phi_rad,
                    radius_mm: *radius_mm,
                };
                frame.cylinder = Some(model).filter(|_| numbers.iter().all(|x| !x.is_nan()));
            }
        }
        Ok(Self(recording))
    }

    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| CoreRecording::read_unchecked(&path)).map(Self).map_err(error)
    }

    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.0.write(&path)).map_err(error)
    }

    fn frames(&self) -> usize {
        self.0.frames.len()
    }

    fn poses<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        let mut poses = Array3::zeros((self.0.frames.len(), 4, 4));
        for (k, frame) in self.0.frames.iter().enumerate() {
            let pose = &frame.world_from_sensor;
            for r in 0..3 {
                for c in 0..3 {
                    poses[[k, r, c]] = pose.rotation.col(c)[r];
                }
                poses[[k, r, 3]] = pose.translation_mm[r];
            }
            poses[[k, 3, 3]] = 1.0;
        }
        poses.into_pyarray(py)
    }

    fn contours<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyArray2<f64>>> {
        let points = |frame: &Frame| {
            let at = |(k, c): (usize, usize)| frame.contour_mm[k][c];
            Array2::from_shape_fn((frame.contour_mm.len(), 2), at).into_pyarray(py)
        };
        self.0.frames.iter().map(points).collect()
    }

    fn time<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.of_frames(py, |frame| frame.time_s)
    }

    fn phase<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.of_frames(py, |frame| frame.phase)
    }

    fn cylinders<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray2<f64>>> {
        let frames = &self.0.frames;
        let at = |(k, c): (usize, usize)| {
            let model = frames[k].cylinder.as_ref();
            model.map_or(f64::NAN, |m| [m.px_mm, m.py_mm, m.theta_rad, m.phi_rad, m.radius_mm][c])
        };
        let some = frames.iter().any(|frame| frame.cylinder.is_some());
        some.then(|| Array2::from_shape_fn((frames.len(), 5), at).into_pyarray(py))
    }
}

/// A triangle mesh with arrays over its nodes.
#[pyclass(frozen, module = "lumenmesh._lumenmesh")]
struct NativeMesh(Surface);

#[pymethods]
impl NativeMesh {
    #[new]
    fn new(
        vertices: PyReadonlyArray2<'_, f64>,
        faces: PyReadonlyArray2<'_, i64>,
        point_data: Vec<(String, PyReadonlyArray1<'_, f64>)>,
    ) -> PyResult<Self> {
        let nodes_mm: Vec<DVec3> =
            vertices.as_slice()?.as_chunks::<3>().0.iter().copied().map(DVec3::from_array).collect();
        let index = |(t, corners): (usize, &[i64; 3])| {
            let is_node = |n: &i64| usize::try_from(*n).is_ok_and(|n| n < nodes_mm.len());
            match corners.iter().find(|n| !is_node(n)) {
                Some(n) => Err(Error::new_err(format!(
                    "faces: row {t}: found {n}, expected a vertex from 0 to {}",
                    nodes_mm.len() as i64 - 1
                ))),
                None => Ok(corners.map(|n| n as u32)),
            }
        };
        let triangles =
            faces.as_slice()?.as_chunks::<3>().0.iter().enumerate().map(index).collect::<PyResult<_>>()?;
        let mut arrays = Vec::new();
        for (name, values) in point_data {
            arrays.push(NodeArray { name, values: values.as_slice()?.to_vec() });
        }
        let surface = Surface { nodes_mm, triangles, arrays };
        surface.check().map_err(error)?;
        Ok(Self(surface))
    }

    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| Surface::read(&path)).map(Self).map_err(error)
    }

    fn write(&self, py: Python<'_>, path: PathBuf, space: &str) -> PyResult<()> {
        let space: Space = space.parse().map_err(error)?;
        py.detach(|| self.0.write_in(&path, space)).map_err(error)
    }

    fn vertices<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let nodes = &self.0.nodes_mm;
        Array2::from_shape_fn((nodes.len(), 3), |(n, c)| nodes[n][c]).into_pyarray(py)
    }

    fn faces<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<i32>> {
        let triangles = &self.0.triangles;
        Array2::from_shape_fn((triangles.len(), 3), |(t, c)| triangles[t][c] as i32).into_pyarray(py)
    }

    fn point_data<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let arrays = PyDict::new(py);
        for array in &self.0.arrays {
            arrays.set_item(&array.name, Array1::from(array.values.clone()).into_pyarray(py))?;
        }
        Ok(arrays)
    }

    /// A picture as the bytes of a PNG file, coloured by an array.
    fn picture(&self, py: Python<'_>, array: Option<String>, width: u32, height: u32) -> PyResult<Vec<u8>> {
        let style = Style::default().with_array(array).with_size([width, height]);
        py.detach(|| render(&self.0, &style)?.png()).map_err(error)
    }

    /// The numbers of `lumenmesh evaluate --json`.
    fn evaluate(&self, py: Python<'_>, truth: &Self) -> PyResult<String> {
        let measured = py.detach(|| {
            let truth = Truth::new(truth.0.clone())?;
            evaluate_surface(&self.0, &truth)
        });
        json(measured.map_err(error)?)
    }
}

/// How often a reconstruction lets Python look for signals, such as that of Ctrl-C.
const LOOK_FOR_SIGNALS: Duration = Duration::from_millis(50);

/// The lumen's mesh, and the report as JSON.
#[pyfunction]
fn reconstruct(
    py: Python<'_>,
    recording: &NativeRecording,
    settings: Vec<(String, String)>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(NativeMesh, String)> {
    let settings = settings_of(&settings)?;
    // What was raised first, by the callback or by a signal; the work ends with it.
    let raised: Mutex<Option<PyErr>> = Mutex::new(None);
    let stopped = AtomicBool::new(false);
    let ask = |question: &dyn Fn(Python<'_>) -> PyResult<()>| match Python::attach(question) {
        Ok(()) => ControlFlow::Continue(()),
        Err(error) => {
            stopped.store(true, Ordering::Relaxed);
            raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
            ControlFlow::Break(())
        }
    };
    // Threads call back in turns, so that none does after one that raised.
    let turn = Mutex::new(());
    let tell = |Progress { stage, done, total, .. }: Progress| {
        let _turn = turn.lock().unwrap_or_else(PoisonError::into_inner);
        if stopped.load(Ordering::Relaxed) {
            return ControlFlow::Break(());
        }
        let Some(progress) = &progress else { return ControlFlow::Continue(()) };
        ask(&|py| progress.call1(py, (stage, done, total)).map(drop))
    };
    // Python hears of Ctrl-C on its main thread only, which the work would keep busy.
    let lumen = py.detach(|| {
        std::thread::scope(|threads| {
            let (give, take) = mpsc::channel();
            threads.spawn(move || {
                // It fails where nobody waits any more.
                drop(give.send(Reconstructor::new(settings).on_progress(tell).run(&recording.0)));
            });
            loop {
                match take.recv_timeout(LOOK_FOR_SIGNALS) {
                    Err(mpsc::RecvTimeoutError::Timeout) => {
                        // What this finds, `tell` heeds.
                        let _ = ask(&|py| py.check_signals());
                    }
                    Ok(lumen) => return Some(lumen),
                    // It panicked: the scope passes that on.
                    Err(mpsc::RecvTimeoutError::Disconnected) => return None,
                }
            }
        })
    });
    if let Some(raised) = raised.into_inner().unwrap_or_else(PoisonError::into_inner) {
        return Err(raised);
    }
    let lumen = lumen.ok_or_else(|| Error::new_err("reconstruct: failed within lumenmesh"))?;
    lumen_parts(py, &lumen.map_err(error)?)
}

fn lumen_parts(py: Python<'_>, lumen: &Lumen) -> PyResult<(NativeMesh, String)> {
    let report = json(lumen.summary())?;
    Ok((NativeMesh(py.detach(|| lumen.surface())), report))
}

/// A recording of a phantom, and its wall.
#[pyfunction]
fn simulate(
    py: Python<'_>,
    vessel: &str,
    seed: u64,
    noise: bool,
    rays: usize,
    steady: bool,
) -> PyResult<(NativeRecording, NativeMesh)> {
    let shape: Shape = vessel.parse().map_err(error)?;
    let levels = if noise { Noise::default() } else { Noise::none() };
    let mut settings = SimulationSettings::default()
        .with_noise(levels.with_seed(seed))
        .with_probe(Probe::default().with_rays(rays));
    if steady {
        settings = settings.with_insertion(lumenmesh_core::simulate::Insertion::steady());
    }
    let simulation =
        py.detach(|| Simulation::run(Phantom::from(shape).vessel()?, &settings)).map_err(error)?;
    let wall = simulation.vessel.surface().clone();
    Ok((NativeRecording(simulation.recording), NativeMesh(wall)))
}

/// What a frame changed: frame, before, changed, rings, off_axis, left_out (JSON), waiting, restarted, times (of screening,
/// axis, placing, solving, and in all, s).
type ChangeTuple = (usize, usize, Vec<(usize, usize)>, usize, bool, String, usize, bool, [f64; 5]);

fn change_tuple(change: CoreChange) -> PyResult<ChangeTuple> {
    let ranges = change.changed.iter().map(|range| (range.start, range.end)).collect();
    // Most frames leave none out.
    let left_out = if change.left_out.is_empty() { "[]".into() } else { json(&change.left_out)? };
    let times = change.times;
    Ok((
        change.frame,
        change.before,
        ranges,
        change.rings,
        change.off_axis,
        left_out,
        change.waiting,
        change.restarted,
        [times.screening_s, times.axis_s, times.placing_s, times.solving_s, times.total_s],
    ))
}

/// A vessel that grows frame by frame. Calls from several threads wait for each other.
#[pyclass(frozen, module = "lumenmesh._lumenmesh")]
struct NativeLive(Mutex<CoreLive>);

impl NativeLive {
    /// What `work` makes of the vessel; other Python threads run meanwhile.
    fn with<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut CoreLive) -> T + Send) -> PyResult<T> {
        py.detach(|| self.0.lock().map(|mut live| work(&mut live)).map_err(|_| ()))
            .map_err(|()| Error::new_err("live: an earlier call failed within lumenmesh; begin a new one"))
    }
}

#[pymethods]
impl NativeLive {
    #[new]
    fn new(settings: Vec<(String, String)>, keep_frames: bool) -> PyResult<Self> {
        let mut live = CoreLive::new(&settings_of(&settings)?).map_err(error)?;
        if keep_frames {
            live.keep_frames().map_err(error)?;
        }
        Ok(Self(Mutex::new(live)))
    }

    #[staticmethod]
    fn restore(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| CoreLive::restore(&path)).map(|live| Self(Mutex::new(live))).map_err(error)
    }

    fn snapshot(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.with(py, |live| live.snapshot(&path))?.map_err(error)
    }

    fn finish(&self, py: Python<'_>) -> PyResult<(NativeMesh, String)> {
        lumen_parts(py, &self.with(py, |live| live.finish())?.map_err(error)?)
    }

    fn push(
        &self,
        py: Python<'_>,
        pose: PyReadonlyArray2<'_, f64>,
        points: PyReadonlyArray2<'_, f64>,
        time: Option<f64>,
    ) -> PyResult<ChangeTuple> {
        let frame = Frame::from_matrix(&matrix(pose.as_slice()?), contour(&points)?).map_err(error)?;
        let frame = frame.with_time_s(time.filter(|t| !t.is_nan()));
        change_tuple(self.with(py, |live| live.push(&frame))?.map_err(error)?)
    }

    fn flush(&self, py: Python<'_>) -> PyResult<ChangeTuple> {
        change_tuple(self.with(py, CoreLive::flush)?.map_err(error)?)
    }

    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, CoreLive::reset)
    }

    fn frames(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |live| live.frames())
    }

    fn rings(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |live| live.rings())
    }

    fn nodes(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |live| live.nodes())
    }

    fn branches(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |live| live.branches())
    }

    /// As JSON.
    fn engine(&self, py: Python<'_>) -> PyResult<String> {
        json(self.with(py, |live| live.engine())?)
    }

    fn surface(&self, py: Python<'_>) -> PyResult<NativeMesh> {
        self.with(py, |live| NativeMesh(live.surface()))
    }

    fn part(&self, py: Python<'_>, first: usize, end: usize) -> PyResult<NativeMesh> {
        self.with(py, |live| NativeMesh(live.part(first..end)))
    }
}

/// The native part of `lumenmesh`.
#[pymodule]
fn _lumenmesh(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("Error", module.py().get_type::<Error>())?;
    module.add_class::<NativeRecording>()?;
    module.add_class::<NativeMesh>()?;
    module.add_class::<NativeLive>()?;
    module.add_function(wrap_pyfunction!(reconstruct, module)?)?;
    module.add_function(wrap_pyfunction!(simulate, module)?)
}
