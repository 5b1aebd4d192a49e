//! A progress bar on standard error that shows itself only after two seconds.

use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::eval::Progress;

/// How long a command stays silent.
const PATIENCE: Duration = Duration::from_secs(2);
const REDRAW: Duration = Duration::from_millis(200);

/// The bar, and the thread that draws it.
pub(super) struct Bar {
    shown: Arc<ProgressBar>,
    stop: Option<Sender<()>>,
    drawer: Option<JoinHandle<()>>,
}

impl Bar {
    pub(super) fn new() -> Self {
        let bar = ProgressBar::hidden();
        if let Ok(style) = ProgressStyle::with_template(
            "{msg:>18} {bar:32} {human_pos}/{human_len} ({per_sec}, {eta} left)",
        ) {
            bar.set_style(style);
        }
        let bar = Arc::new(bar);
        let (stop, stopped) = channel();
        let drawn = Arc::clone(&bar);
        let drawer = std::thread::spawn(move || {
            if stopped.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
                drawn.set_draw_target(ProgressDrawTarget::stderr());
                while stopped.recv_timeout(REDRAW) == Err(RecvTimeoutError::Timeout) {
                    drawn.tick();
                }
                drawn.finish_and_clear();
            }
        });
        Self { shown: bar, stop: Some(stop), drawer: Some(drawer) }
    }
}

impl Progress for Bar {
    fn begin(&self, stage: &str, total: u64) {
        self.shown.reset();
        self.shown.set_length(total);
        self.shown.set_message(stage.to_owned());
    }

    fn advance(&self, steps: u64) {
        self.shown.inc(steps);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(drawer) = self.drawer.take() {
            // The drawing thread cannot fail in a way that matters to the results.
            let _ = drawer.join();
        }
    }
}
