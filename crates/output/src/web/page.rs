//! The page's text: what it shows and does, with the data in it.

use std::io::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde_json::Value;

use rekindle_base::staging::MAKER;
use rekindle_base::text::xml_attribute;

const HTML: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/style.css");
/// The scripts in the order in which they need each other.
const SCRIPTS: [&str; 6] = [
    include_str!("page/vectors.js"),
    include_str!("page/unpack.js"),
    include_str!("page/light.js"),
    include_str!("page/renderer.js"),
    include_str!("page/panel.js"),
    include_str!("page/main.js"),
];
/// The shaders by the names that the scripts know them by.
const SHADERS: [(&str, &str); 6] = [
    ("surface-vertex", include_str!("page/surface.vert")),
    ("surface-fragment", include_str!("page/surface.frag")),
    ("shadow-vertex", include_str!("page/shadow.vert")),
    ("fullscreen-vertex", include_str!("page/fullscreen.vert")),
    ("mean-fragment", include_str!("page/mean.frag")),
    ("display-fragment", include_str!("page/display.frag")),
];

/// The page's data.
#[derive(Default)]
pub(super) struct Page {
    /// One element for each piece.
    data: String,
}

impl Page {
    /// Adds numbers, packed.
    pub(super) fn pack(&mut self, name: &str, bytes: &[u8]) {
        let mut packed = ZlibEncoder::new(Vec::new(), Compression::best());
        // Memory takes all that is written to it.
        let packed = packed.write_all(bytes).and_then(|()| packed.finish());
        self.put(name, "application/zlib", &packed.unwrap_or_default());
    }

    /// Adds a file of this media type.
    pub(super) fn put(&mut self, name: &str, media: &str, bytes: &[u8]) {
        self.element(name, media, &STANDARD.encode(bytes));
    }

    fn element(&mut self, name: &str, media: &str, text: &str) {
        self.data.push_str("<script id=\"");
        self.data.push_str(name);
        self.data.push_str("\" type=\"");
        self.data.push_str(media);
        self.data.push_str("\">");
        self.data.push_str(text);
        self.data.push_str("</script>\n");
    }

    /// The page of an object of this name.
    pub(super) fn html(mut self, name: &str, scene: &Value) -> String {
        for (name, text) in SHADERS {
            self.element(name, "x-shader/glsl", text);
        }
        self.element("scene", "application/json", &in_script(&scene.to_string()));
        let mut html = String::with_capacity(self.data.len() + (1 << 16));
        let mut rest = HTML;
        for (mark, text) in [
            ("{{maker}}", MAKER),
            ("{{title}}", &xml_attribute(name)),
            ("{{style}}", STYLE),
            ("{{data}}", &self.data),
            ("{{scripts}}", &SCRIPTS.concat()),
        ] {
            let (before, after) = rest.split_once(mark).unwrap_or((rest, ""));
            html.push_str(before);
            html.push_str(text);
            rest = after;
        }
        html.push_str(rest);
        html
    }
}

/// JSON that no name in it can end the element of: `<` only occurs in strings, where it has another spelling.
fn in_script(json: &str) -> String {
    json.replace('<', "\\u003c")
}
