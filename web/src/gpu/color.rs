//! Colours, and the two themes of the canvas.

/// An sRGB colour with straight alpha, as the page's style sheet writes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Color {
    /// Red, 0..=255.
    pub r: u8,
    /// Green.
    pub g: u8,
    /// Blue.
    pub b: u8,
    /// Opacity.
    pub a: u8,
}

impl Color {
    /// Opaque, from `0xRRGGBB`.
    pub const fn hex(rgb: u32) -> Self {
        Self { r: (rgb >> 16) as u8, g: (rgb >> 8) as u8, b: rgb as u8, a: 255 }
    }

    /// The same colour with this opacity (0..=1) times its own.
    pub fn alpha(self, opacity: f32) -> Self {
        Self { a: (f32::from(self.a) * opacity.clamp(0.0, 1.0)).round() as u8, ..self }
    }

    /// `other` for `share` 1, `self` for 0, in between for in between.
    pub fn mix(self, other: Self, share: f32) -> Self {
        let share = share.clamp(0.0, 1.0);
        let one = |from: u8, to: u8| (f32::from(from) + (f32::from(to) - f32::from(from)) * share).round() as u8;
        Self { r: one(self.r, other.r), g: one(self.g, other.g), b: one(self.b, other.b), a: one(self.a, other.a) }
    }

    /// The same colour `#rrggbb` for the style sheet of a legend.
    pub fn css(self) -> String {
        format!("#{:02x}{:02x}{:02x}", self.r, self.g, self.b)
    }

    /// Bytes in memory order r, g, b, a, as one word of a vertex.
    pub(crate) fn packed(self) -> u32 {
        u32::from_le_bytes([self.r, self.g, self.b, self.a])
    }

    /// The clear value of a render pass on a non-sRGB surface.
    pub(crate) fn clear(self) -> wgpu::Color {
        let one = |byte: u8| f64::from(byte) / 255.0;
        wgpu::Color { r: one(self.r), g: one(self.g), b: one(self.b), a: one(self.a) }
    }
}

/// What the canvas needs to know of the page's colours. The style sheet's custom properties of the
/// same names must agree, as the canvas shows through the page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Theme {
    /// Is the page dark?
    pub dark: bool,
    /// Behind everything (`--page`).
    pub page: Color,
    /// Behind curves (`--plot`).
    pub plot: Color,
    /// Grid lines.
    pub grid: Color,
    /// The zero line and the frame of a plot.
    pub axis: Color,
    /// Strongest contrast to `plot`: the cursor, the setpoint line.
    pub ink: Color,
    /// Sky of the horizon.
    pub sky: Color,
    /// Earth of the horizon.
    pub earth: Color,
}

impl Theme {
    /// Dark lettering on light.
    pub const LIGHT: Self = Self {
        dark: false,
        page: Color::hex(0xf3f4f6),
        plot: Color::hex(0xffffff),
        grid: Color::hex(0xe3e6ea),
        axis: Color::hex(0xb4bac2),
        ink: Color::hex(0x1c2128),
        sky: Color::hex(0x3f8fd2),
        earth: Color::hex(0x96673a),
    };
    /// Light lettering on dark.
    pub const DARK: Self = Self {
        dark: true,
        page: Color::hex(0x0f1216),
        plot: Color::hex(0x161a20),
        grid: Color::hex(0x262c34),
        axis: Color::hex(0x4a535f),
        ink: Color::hex(0xe8ecf1),
        sky: Color::hex(0x2b6ca8),
        earth: Color::hex(0x6f4a28),
    };

    /// The theme for a dark or a light page.
    pub const fn of(dark: bool) -> Self {
        if dark { Self::DARK } else { Self::LIGHT }
    }
}
