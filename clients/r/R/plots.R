# Pictures, by base graphics.

# Colours that also differ to people who do not tell red from green.
colours <- function(n) rep_len(grDevices::palette.colors(9, "Okabe-Ito")[c(6, 7, 4, 2, 8, 3, 5, 9, 1)], n)

# Pairs of axes that are drawn: one for shapes in the plane, two for shapes in space.
views <- function(k) if (k == 2) list(c(1, 2)) else list(c(1, 2), c(1, 3))

# Columns of a legend, which stands above the frame, where no shape is; and the margins with room for it and the title.
LEGEND_COLUMNS <- 2

margins_for <- function(main, legend) c(4, 4, 1 + 1.2 * ceiling(length(legend) / LEGEND_COLUMNS) + if (nzchar(main)) 2 else 0, 1)

legend_above <- function(names, ...) {
  if (length(names) == 0) return(invisible())
  box <- graphics::par("usr")
  graphics::legend((box[1] + box[2]) / 2, box[4], names, ncol = min(length(names), LEGEND_COLUMNS), xjust = 0.5, yjust = 0, bty = "n", xpd = NA,
                   cex = 0.85, ...)
}

# An empty frame of equal scales around points, of any number of views; `draw` is called in each with the axes of the view.
frames <- function(points, draw, main = "", legend = NULL) {
  axes <- views(ncol(points))
  margins <- margins_for(main, legend)
  # To set `mfrow` begins a new page: only where there are two views.
  old <- if (length(axes) > 1) graphics::par(mfrow = c(1, 2), mar = margins) else graphics::par(mar = margins)
  on.exit(graphics::par(old))
  for (view in axes) {
    shown <- points[, view]
    shown <- shown[stats::complete.cases(shown), , drop = FALSE]
    names <- c("X", "Y", "Z")[view]
    graphics::plot(shown, type = "n", asp = 1, xlab = names[1], ylab = names[2])
    draw(view)
    graphics::title(main, line = margins[3] - 1.6)
    if (identical(view, axes[[1]])) legend_above(legend, col = colours(length(legend)), pch = 19, lwd = 2)
  }
}

draw_links <- function(points, links, ...) {
  if (is.null(links)) return(invisible())
  graphics::segments(points[links[, 1], 1], points[links[, 1], 2], points[links[, 2], 1], points[links[, 2], 2], ...)
}

stacked <- function(a) matrix(aperm(a, c(1, 3, 2)), ncol = dim(a)[2])

# Links are pairs of numbers of points, a row each, counted from 1.
checked_links <- function(links, p) {
  if (is.null(links)) return(NULL)
  links <- as.matrix(links)
  if (ncol(links) != 2 || !all(links %in% seq_len(p))) {
    stop("`links`: expected pairs of numbers of points from 1 to ", p, ", a row each, got ", shown(links), call. = FALSE)
  }
  links
}

plot.shapelex_gpa <- function(x, links = NULL, label = FALSE, main = "", ...) {
  links <- checked_links(links, nrow(x$consensus))
  all <- stacked(x$coords)
  frames(all, function(view) {
    graphics::points(all[, view], pch = 19, cex = 0.4, col = grDevices::adjustcolor("grey40", 0.6))
    mean <- x$consensus[, view]
    draw_links(mean, links, lwd = 2)
    graphics::points(mean, pch = 21, bg = "black", cex = 1)
    if (label) graphics::text(mean, labels = seq_len(nrow(mean)), pos = 4, cex = 0.8)
  }, main)
  invisible(x)
}

plot.shapelex_pca <- function(x, type = c("scores", "shapes", "variance"), axis1 = 1, axis2 = 2, groups = NULL, hulls = TRUE, sigma = 2,
                              links = NULL, main = "", ...) {
  switch(match.arg(type),
    scores = plot_scores(x, axis1, axis2, groups, hulls, main),
    shapes = plot_axis(x, axis1, sigma, checked_links(links, nrow(x$center)), main),
    variance = graphics::barplot(100 * x$explained, names.arg = seq_along(x$explained), xlab = "Component", ylab = "Variance (%)",
                                 main = main, border = NA)
  )
  invisible(x)
}

plot_scores <- function(x, axis1, axis2, groups, hulls, main) {
  scores <- x$x[, c(axis1, axis2)]
  if (is.null(groups)) groups <- factor(rep("", nrow(scores)))
  groups <- as.factor(groups)
  if (length(groups) != nrow(scores)) stop("`groups`: expected ", nrow(scores), " values, one a shape, got ", length(groups), call. = FALSE)
  colour <- colours(nlevels(groups))
  names <- sprintf("PC%d (%.1f %%)", c(axis1, axis2), 100 * x$explained[c(axis1, axis2)])
  told <- if (nlevels(groups) > 1) levels(groups)
  old <- graphics::par(mar = margins_for(main, told))
  on.exit(graphics::par(old))
  graphics::plot(scores, asp = 1, type = "n", xlab = names[1], ylab = names[2])
  graphics::title(main, line = graphics::par("mar")[3] - 1.6)
  graphics::abline(h = 0, v = 0, col = "grey85")
  for (k in if (hulls && nlevels(groups) > 1) seq_len(nlevels(groups))) {
    own <- scores[which(groups == levels(groups)[k]), , drop = FALSE]
    graphics::polygon(own[grDevices::chull(own), , drop = FALSE], border = colour[k], col = grDevices::adjustcolor(colour[k], 0.12))
  }
  graphics::points(scores, pch = 20 + 1 + (as.integer(groups) - 1) %% 5, bg = colour[groups], col = "white", cex = 1.2)
  legend_above(told, pt.bg = colour, col = "white", pch = 21 + (seq_along(told) - 1) %% 5, pt.cex = 1.2)
}

# The mean and the two sides of a component.
plot_axis <- function(x, component, sigma, links, main) {
  sides <- shapes_at(x, component, c(-sigma, sigma) * x$sdev[component])
  overlaid(sides, x$center, links, main, sprintf("PC%d at %+g standard deviations", component, c(-sigma, sigma)))
}

# Shapes in colours over the mean in grey.
overlaid <- function(shapes, mean, links, main, names) {
  frames(rbind(stacked(shapes), mean), function(view) {
    if (!is.null(mean)) {
      draw_links(mean[, view], links, col = "grey75")
      graphics::points(mean[, view], pch = 19, cex = 0.6, col = "grey60")
    }
    for (k in seq_len(dim(shapes)[3])) {
      colour <- colours(dim(shapes)[3])[k]
      draw_links(shapes[, view, k], links, col = colour, lwd = 2)
      graphics::points(shapes[, view, k], pch = 19, cex = 0.8, col = colour)
    }
  }, main, names)
}

plot.shapelex_comparison <- function(x, mag = 1, links = NULL, main = "", ...) {
  mean <- rowMeans(x$means, dims = 2)
  overlaid(magnified(x$means, mean, mag), NULL, checked_links(links, nrow(mean)), main, x$groups$group)
  invisible(x)
}

magnified <- function(shapes, mean, mag) as.vector(mean) + mag * (shapes - as.vector(mean))

plot.shapelex_regression <- function(x, type = c("scores", "shapes"), groups = NULL, mag = 1, links = NULL, xlab = "x", main = "", ...) {
  if (match.arg(type) == "scores") {
    groups <- if (is.null(groups)) factor(rep("", length(x$x))) else as.factor(groups)
    told <- if (nlevels(groups) > 1) levels(groups)
    old <- graphics::par(mar = margins_for(main, told))
    on.exit(graphics::par(old))
    graphics::plot(x$x, x$RegScore, pch = 21, bg = colours(nlevels(groups))[groups], col = "white", cex = 1.2, xlab = xlab,
                   ylab = "Regression score")
    graphics::title(main, line = graphics::par("mar")[3] - 1.6)
    legend_above(told, pt.bg = colours(nlevels(groups)), col = "white", pch = 21, pt.cex = 1.2)
  } else {
    names <- paste(xlab, "=", vapply(x$predictions$x, format, "", digits = 3))
    overlaid(magnified(x$predictions$shapes, x$mean, mag), NULL, checked_links(links, nrow(x$mean)), main, names)
  }
  invisible(x)
}

plot.shapelex_lm <- function(x, type = c("predictions", "permutations"), mag = 1, links = NULL, main = "", ...) {
  if (match.arg(type) == "predictions") {
    shapes <- magnified(x$predictions$shapes, x$consensus, mag)
    overlaid(shapes, x$consensus, checked_links(links, nrow(x$consensus)), main, dimnames(x$predictions$shapes)[[3]])
  } else {
    plot_permutations(x)
  }
  invisible(x)
}

# Partial η² = SS/(SS + RSS) of the exchanges of each term, and the observed one.
plot_permutations <- function(x) {
  terms <- Filter(Negate(is.null), x$histograms)
  if (length(terms) == 0) stop("expected a model with permutations, got one without", call. = FALSE)
  old <- graphics::par(mfrow = grDevices::n2mfrow(length(terms)), mar = c(4, 4, 3, 1))
  on.exit(graphics::par(old))
  for (name in names(terms)) {
    counts <- unlist(terms[[name]]$counts)
    width <- terms[[name]]$upper / length(counts)
    observed <- x$terms$partial.eta.sq[x$terms$term == name]
    frame <- list(c(0, max(terms[[name]]$upper, observed)), c(0, max(counts)))
    graphics::plot(NULL, xlim = frame[[1]], ylim = frame[[2]], xlab = "SS / (SS + RSS)", ylab = "Permutations", main = name)
    graphics::rect((seq_along(counts) - 1) * width, 0, seq_along(counts) * width, counts, col = "grey80", border = NA)
    graphics::abline(v = observed, lwd = 2, col = colours(2)[2])
  }
}

plot_change <- function(ref, target, method = c("TPS", "vector", "points"), mag = 1, links = NULL, main = "") {
  ref <- as.matrix(ref)
  if (!is.numeric(ref) || !identical(dim(ref), dim(as.matrix(target)))) {
    stop("`target`: expected points \u00d7 coordinates as `ref` has them, ", paste(dim(ref), collapse = " \u00d7 "), ", got ",
         paste(dim(as.matrix(target)), collapse = " \u00d7 "), call. = FALSE)
  }
  links <- checked_links(links, nrow(ref))
  moved <- ref + mag * (as.matrix(target) - ref)
  draw <- switch(match.arg(method), TPS = draw_grid, vector = draw_vectors, points = draw_both)
  frames(rbind(ref, moved, if (match.arg(method) == "TPS") grid_box(ref)), function(view) draw(ref[, view], moved[, view], links), main)
  invisible(moved)
}

draw_vectors <- function(ref, moved, links) {
  draw_links(ref, links, col = "grey70")
  length <- sqrt(rowSums((moved - ref)^2))
  far <- length > 1e-3 * max(length, 1e-300)
  if (any(far)) graphics::arrows(ref[far, 1], ref[far, 2], moved[far, 1], moved[far, 2], length = 0.08, lwd = 2, col = colours(1))
  graphics::points(ref, pch = 21, bg = "black", cex = 0.9)
}

draw_both <- function(ref, moved, links) {
  draw_links(ref, links, col = "grey70")
  draw_links(moved, links, col = colours(1), lwd = 2)
  graphics::points(ref, pch = 19, col = "grey60", cex = 0.9)
  graphics::points(moved, pch = 19, col = colours(1), cex = 0.9)
}

# Corners of the box of a grid, a tenth larger than the points.
grid_box <- function(ref) {
  sides <- apply(ref, 2, function(x) range(x) + c(-0.1, 0.1) * diff(range(x)))
  as.matrix(expand.grid(as.data.frame(sides)))
}

# A square grid over the reference, carried along by the thin-plate spline that takes it to the target.
draw_grid <- function(ref, moved, links) {
  box <- apply(grid_box(ref), 2, range)
  step <- max(box[2, ] - box[1, ]) / 20
  warp <- thin_plate(ref, moved)
  fine <- lapply(1:2, function(j) seq(box[1, j], box[2, j], length.out = 80))
  for (x in seq(box[1, 1], box[2, 1], by = step)) graphics::lines(warp(cbind(x, fine[[2]])), col = "grey70")
  for (y in seq(box[1, 2], box[2, 2], by = step)) graphics::lines(warp(cbind(fine[[1]], y)), col = "grey70")
  draw_links(moved, links, lwd = 2)
  graphics::points(moved, pch = 21, bg = "black", cex = 0.9)
}

# The thin-plate spline through pairs of points in the plane (Bookstein 1989), as a function of points:
#   f(x) = Σ w_i U(|x − r_i|) + a + A x,  U(r) = r² log r²,  Σ w_i = 0,  Σ w_i r_i = 0.
thin_plate <- function(ref, moved) {
  p <- nrow(ref)
  bent <- function(x) {
    squared <- outer(rowSums(x^2), rowSums(ref^2), "+") - 2 * tcrossprod(x, ref)
    squared <- pmax(squared, 0)
    ifelse(squared > 0, squared * log(squared), 0)
  }
  affine <- cbind(1, ref)
  system <- rbind(cbind(bent(ref), affine), cbind(t(affine), matrix(0, 3, 3)))
  weights <- qr.solve(system, rbind(moved, matrix(0, 3, 2)), tol = 1e-14)
  function(x) cbind(bent(x), 1, x) %*% weights
}
