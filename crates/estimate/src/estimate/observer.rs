//! How a running solve is watched and stopped.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::SpecularModel;
use rekindle_scene::surface::Atlas;

/// A solve was stopped by its observer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("stopped")]
pub struct Stopped;

/// One step of the minimisation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Iteration {
    /// Counts from 1.
    pub iteration: u32,
    /// Seconds since the estimation began.
    pub elapsed_s: f64,
    /// The method's objective, in squared radiance units of the capture.
    pub objective: f64,
    /// Roughness σ in radians.
    pub sigma: f32,
    /// Weighted root mean square of measured − predicted, in the capture's radiance units.
    pub residual_rms: f32,
}

/// Something that a solve has before it ends, worth showing. All radiances are in the capture's units.
#[derive(Clone, Copy)]
pub enum Interim<'a> {
    /// The surface has its atlas, and the least that the views show of each texel is a first diffuse texture.
    Texture {
        /// Where each triangle lies in the texture.
        atlas: &'a Atlas,
        /// Diffuse radiance per texel, RGB.
        radiance: &'a [[f32; 3]],
    },
    /// What one view says of the lighting (2.2).
    Partial {
        /// Index of the view.
        view: usize,
        /// The nodes.
        grid: &'a HemisphereGrid,
        /// Reflected radiance per node, RGB.
        radiance: &'a [[f32; 3]],
    },
    /// What all views agree on (2.2).
    Initial {
        /// The nodes.
        grid: &'a HemisphereGrid,
        /// Reflected radiance per node, RGB.
        radiance: &'a [[f32; 3]],
    },
    /// The iterations that follow are of this specular model.
    Lobe(SpecularModel),
    /// A roughness was tried on the coarsest cells.
    Tried {
        /// The specular model.
        model: SpecularModel,
        /// Roughness σ, radians.
        sigma: f32,
        /// What it leaves of the differences between views, in squares; comparable until a roughness of a model is tried again, on another
        /// surface or under light from elsewhere.
        unexplained: f64,
    },
}

/// Watches a solve. Every call may stop it by `ControlFlow::Break`. Calls come at least every 100 ms, some of them from
/// another thread than the one that called, but never two at a time.
pub trait Observer: Send {
    /// `fraction` of the estimation is done, in [0, 1]; `what` says in a few words what it is doing.
    fn progress(&mut self, what: &str, fraction: f32) -> ControlFlow<()>;

    /// An iteration ended. `hemisphere` computes the current radiances, RGB per node, if they are wanted.
    fn iteration(
        &mut self,
        iteration: &Iteration,
        hemisphere: &dyn Fn() -> Vec<[f32; 3]>,
    ) -> ControlFlow<()>;

    /// Something is there that can be shown.
    fn interim(&mut self, _: Interim<'_>) {}

    /// Whether the estimation is to end with what it has reached. Asked between steps.
    fn enough(&mut self) -> bool {
        false
    }
}

/// An observer that lets the solve run and keeps nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;

impl Observer for Unobserved {
    fn progress(&mut self, _: &str, _: f32) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn iteration(&mut self, _: &Iteration, _: &dyn Fn() -> Vec<[f32; 3]>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

/// How often an observer is asked while a long step goes on.
const EVERY: Duration = Duration::from_millis(25);

/// Stands between an observer and the work it watches: it remembers what was said last, and that it said stop.
pub struct Watcher<'o> {
    told: Mutex<Told<'o>>,
    stop: AtomicBool,
}

struct Told<'o> {
    observer: &'o mut dyn Observer,
    what: String,
    fraction: f32,
}

impl Watcher<'_> {
    /// Set once the observer wants no more; long loops look at it.
    pub fn stop(&self) -> &AtomicBool {
        &self.stop
    }

    fn ask(&self, question: impl FnOnce(&mut Told<'_>) -> ControlFlow<()>) -> ControlFlow<()> {
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        if self.stop.load(Ordering::Relaxed) {
            return ControlFlow::Break(());
        }
        let answer = question(&mut told);
        if answer.is_break() {
            self.stop.store(true, Ordering::Relaxed);
        }
        answer
    }
}

impl Observer for &Watcher<'_> {
    fn progress(&mut self, what: &str, fraction: f32) -> ControlFlow<()> {
        self.ask(|told| {
            what.clone_into(&mut told.what);
            told.fraction = fraction;
            told.observer.progress(what, fraction)
        })
    }

    fn iteration(
        &mut self,
        iteration: &Iteration,
        hemisphere: &dyn Fn() -> Vec<[f32; 3]>,
    ) -> ControlFlow<()> {
        self.ask(|told| told.observer.iteration(iteration, hemisphere))
    }

    fn interim(&mut self, interim: Interim<'_>) {
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        told.observer.interim(interim);
    }

    fn enough(&mut self) -> bool {
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        told.observer.enough()
    }
}

/// Does some work while a second thread asks the observer every 25 ms whether to go on. Without that thread, if the
/// system has none to give, it is asked between the steps only.
pub fn watched<T>(observer: &mut dyn Observer, work: impl FnOnce(&Watcher<'_>) -> T) -> T {
    let watcher = Watcher {
        told: Mutex::new(Told {
            observer,
            what: "starting".to_owned(),
            fraction: 0.0,
        }),
        stop: AtomicBool::new(false),
    };
    let again = || {
        watcher.ask(|told| {
            let Told { what, fraction, .. } = &*told;
            let (what, fraction) = (what.clone(), *fraction);
            told.observer.progress(&what, fraction)
        })
    };
    let (working, done) = sync_channel::<()>(0);
    std::thread::scope(|scope| {
        let asking = std::thread::Builder::new()
            .name("observer".to_owned())
            .spawn_scoped(scope, move || {
                while done.recv_timeout(EVERY) == Err(RecvTimeoutError::Timeout) {
                    if again().is_break() {
                        return;
                    }
                }
            });
        drop(asking);
        let result = work(&watcher);
        drop(working);
        result
    })
}

/// `?`-friendly form of an observer's answer.
pub(super) fn go_on(answer: ControlFlow<()>) -> Result<(), Stopped> {
    match answer {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Stopped),
    }
}
