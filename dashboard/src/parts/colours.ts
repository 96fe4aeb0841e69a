/** Colours of categories (Okabe and Ito), told apart also by the colour-blind. */
export const CATEGORIES = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a63d2", "#7f7f7f"];
