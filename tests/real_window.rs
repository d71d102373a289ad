//! The program in a real window, on an X server of its own, with a synthetic mouse and keys. Needs Xvfb, xdotool and
//! ImageMagick: `cargo test --release --test real_window -- --ignored`.

#![cfg(target_os = "linux")]

use std::fs::File;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longer than anything here takes on a slow machine.
const PATIENCE: Duration = Duration::from_mins(2);
/// Mean brightness of 255 that only a highlight has.
const HIGHLIGHT: f32 = 200.0;
/// File of what the program says.
const MESSAGES: &str = "messages.txt";
/// Side of the screen's width and height in pixels.
const SCREEN: [u32; 2] = [1280, 820];

/// An X server and the program on it; both end with it.
struct Desk {
    server: Child,
    program: Option<Child>,
    display: String,
    folder: tempfile::TempDir,
}

impl Drop for Desk {
    fn drop(&mut self) {
        for child in self.program.iter_mut().chain([&mut self.server]) {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl Desk {
    fn new() -> Self {
        let mut server = Command::new("Xvfb")
            // Without -noreset the server starts anew whenever its last client has gone, in the middle of whose first call
            // the program may be.
            .args(["-displayfd", "1", "-noreset", "-nolisten", "tcp"])
            .args(["-screen", "0"])
            .arg(format!("{}x{}x24", SCREEN[0], SCREEN[1]))
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb is installed");
        let mut number = String::new();
        let said = server.stdout.take().expect("piped");
        BufReader::new(said)
            .read_line(&mut number)
            .expect("a number");
        Self {
            server,
            program: None,
            display: format!(":{}", number.trim()),
            folder: tempfile::tempdir().expect("a folder"),
        }
    }

    fn start(&mut self) {
        let home = self.folder.path();
        let program = Command::new(env!("CARGO_BIN_EXE_rekindle"))
            .env("DISPLAY", &self.display)
            .env_remove("WAYLAND_DISPLAY")
            .env("XDG_RUNTIME_DIR", home)
            .env("XDG_DATA_HOME", home.join("data"))
            .env("XDG_STATE_HOME", home.join("state"))
            .current_dir(home)
            .stderr(File::create(home.join(MESSAGES)).expect("a file"))
            .spawn()
            .expect("the program starts");
        self.program = Some(program);
    }

    fn xdotool(&self, arguments: &[&str]) -> String {
        let run = Command::new("xdotool")
            .env("DISPLAY", &self.display)
            .args(arguments)
            .output()
            .expect("xdotool is installed");
        String::from_utf8_lossy(&run.stdout).trim().to_owned()
    }

    /// What the program has written to standard error.
    fn messages(&self) -> String {
        let messages = std::fs::read(self.folder.path().join(MESSAGES)).unwrap_or_default();
        String::from_utf8_lossy(&messages).into_owned()
    }

    /// The window, if its title begins so.
    fn window(&self, title: &str) -> Option<String> {
        let found = self.xdotool(&["search", "--name", &format!("^{title}")]);
        found.lines().next().map(str::to_owned)
    }

    /// Waits for the window's title to begin so. Presses a key again and again until it does: a window that was just made
    /// does not hear the first.
    fn wait_for(&mut self, title: &str, key: Option<&str>) {
        let since = Instant::now();
        for round in 0.. {
            if self.window(title).is_some() {
                return;
            }
            let ended = self.program.as_mut().and_then(|p| p.try_wait().ok()?);
            let seen = self
                .window(".*")
                .map(|window| self.xdotool(&["getwindowname", &window]));
            assert!(
                ended.is_none() && since.elapsed() < PATIENCE,
                "no window called {title} but {seen:?}; the program ended: {ended:?} and said: {}",
                self.messages()
            );
            if let (Some(key), 0) = (key, round % 30) {
                if let Some(window) = self.window(".*Rekindle") {
                    self.xdotool(&["windowfocus", &window]);
                }
                self.key(key);
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    fn key(&self, key: &str) {
        self.xdotool(&["key", "--clearmodifiers", key]);
        std::thread::sleep(Duration::from_millis(300));
    }

    fn screen(&self) -> image::RgbImage {
        let file = self.folder.path().join("screen.png");
        let run = Command::new("import")
            .env("DISPLAY", &self.display)
            .args(["-window", "root"])
            .arg(&file)
            .status()
            .expect("ImageMagick is installed");
        assert!(run.success(), "no picture of the screen");
        image::open(&file).expect("a picture").to_rgb8()
    }

    /// Waits until the screen stands still and shows what is looked for; returns it with what was seen.
    fn wait_to_see<T>(
        &self,
        what: &str,
        look: impl Fn(&image::RgbImage) -> Option<T>,
    ) -> (image::RgbImage, T) {
        let since = Instant::now();
        let mut before = self.screen();
        loop {
            std::thread::sleep(Duration::from_secs(1));
            let now = self.screen();
            if let Some(seen) = look(&now).filter(|_| now == before) {
                return (now, seen);
            }
            if since.elapsed() > PATIENCE {
                keep(&now, "real_unexpected");
                panic!("not seen: {what}");
            }
            before = now;
        }
    }

    /// Takes the mouse along a path with its button held, then off the object.
    fn drag(&self, path: &[[u32; 2]]) {
        for (i, at) in path.iter().enumerate() {
            self.point(*at);
            if i == 0 {
                self.xdotool(&["mousedown", "1"]);
                std::thread::sleep(Duration::from_millis(400));
            }
        }
        self.xdotool(&["mouseup", "1"]);
        self.point([4, SCREEN[1] / 2]);
    }

    fn point(&self, at: [u32; 2]) {
        let [x, y] = at.map(|v| v.to_string());
        self.xdotool(&["mousemove", &x, &y]);
        std::thread::sleep(Duration::from_millis(400));
    }
}

/// Mean brightness around a place.
fn brightness(screen: &image::RgbImage, [x, y]: [u32; 2]) -> f32 {
    const REACH: u32 = 3;
    let mut sum = 0.0;
    let mut count = 0.0;
    for row in y - REACH..=y + REACH {
        for column in x - REACH..=x + REACH {
            let pixel = screen.get_pixel(column, row);
            sum += pixel.0.iter().map(|&v| f32::from(v)).sum::<f32>() / 3.0;
            count += 1.0;
        }
    }
    sum / count
}

#[test]
#[ignore = "needs Xvfb, xdotool and ImageMagick"]
fn a_lamp_is_dragged_and_its_highlight_moves() {
    let mut desk = Desk::new();
    desk.start();
    desk.wait_for("Rekindle", None);
    if let Some(window) = desk.window("Rekindle") {
        let [width, height] = SCREEN.map(|side| side.to_string());
        desk.xdotool(&["windowmove", &window, "0", "0"]);
        desk.xdotool(&["windowsize", &window, &width, &height]);
    }
    desk.wait_for("demo", Some("ctrl+d"));
    desk.wait_for("demo, estimation", Some("ctrl+Return"));
    desk.wait_for("demo.*relighting", None);
    // The first lamp; its highlight follows the mouse over the object.
    desk.key("n");
    let (before, [from, to]) = desk.wait_to_see("an object", places);
    let between = [u32::midpoint(from[0], to[0]), from[1]];
    desk.drag(&[from, between, from]);
    let lit = |at: [u32; 2], screen: &image::RgbImage| brightness(screen, at) > HIGHLIGHT;
    let (first, ()) = desk.wait_to_see("the highlight at the first place", |screen| {
        (lit(from, screen) && !lit(to, screen)).then_some(())
    });
    desk.drag(&[from, between, to]);
    let (second, ()) = desk.wait_to_see("the highlight at the second place", |screen| {
        (lit(to, screen) && !lit(from, screen)).then_some(())
    });
    keep(&before, "real_before");
    keep(&first, "real_first");
    keep(&second, "real_second");
    desk.key("ctrl+q");
}

/// Two places on the object's flank, on the row that shows most of it: near enough to each other to lie on one smooth part.
fn places(screen: &image::RgbImage) -> Option<[[u32; 2]; 2]> {
    // The object is what is brighter than the stage, right of the side panel and above the bar.
    let [left, right] = [440, SCREEN[0] - 40];
    let [top, bottom] = [120, SCREEN[1] - 160];
    let bright = |x: u32, y: u32| brightness(screen, [x, y]) > 45.0;
    let mut best = (0, 0, 0);
    for y in (top..bottom).step_by(8) {
        let lit: Vec<u32> = (left..right).step_by(8).filter(|&x| bright(x, y)).collect();
        if lit.len() > best.2 {
            best = (lit[0], y, lit.len());
        }
    }
    let (x, y, count) = best;
    let width = 8 * count as u32;
    (count > 30).then_some([[x + width / 5, y], [x + 2 * width / 5, y]])
}

/// Keeps a picture where the environment asks for it.
fn keep(screen: &image::RgbImage, name: &str) {
    if let Some(folder) = std::env::var_os("REKINDLE_SCREENS") {
        let file = Path::new(&folder).join(format!("{name}.png"));
        screen.save(file).expect("written");
    }
}
