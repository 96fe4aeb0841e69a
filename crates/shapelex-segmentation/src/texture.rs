//! Textures of label images, by which photographs are told from objects.

/// Division of labels into pieces, by which a photograph is told from objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Texture {
    /// Number of different labels.
    pub labels: usize,
    /// Number of cells that have one.
    pub cells: usize,
    /// Number of components.
    pub components: usize,
    /// Number of components of at most [`Texture::CRUMB`] cells.
    pub crumbs: usize,
    /// Number of cells of these.
    pub crumb_cells: usize,
}

impl Texture {
    /// Number of cells up to which a component is a crumb: no object has an outline of so few.
    pub const CRUMB: u32 = 3;
    /// Number of labels from which on an image may be a photograph: micrographs of 8 bits have 33 and more grey values.
    const MANY: usize = 16;
    /// Part of the cells that are crumbs in a photograph. Of 20 micrographs and 24 volumes they are 24 % and more, 2.6 % of a
    /// silhouette whose edges are smooth, and less than 0.1 % of masks with specks.
    const CRUMBLED: f64 = 0.01;

    /// Whether the labels are grey values: there are many of them, most components are crumbs, and these are not few specks.
    pub fn is_photograph(&self) -> bool {
        let share = self.crumb_cells as f64 / self.cells.max(1) as f64;
        self.labels >= Self::MANY && 2 * self.crumbs > self.components && share >= Self::CRUMBLED
    }
}
