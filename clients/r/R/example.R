# Made shapes for examples, as no data of others are shipped.

example_shapes <- function(n = 40, seed = 1) {
  # Separate draws, after which those of the session go on as if there had been none.
  before <- get0(".Random.seed", globalenv(), inherits = FALSE)
  on.exit(if (is.null(before)) rm(".Random.seed", envir = globalenv()) else assign(".Random.seed", before, globalenv()))
  set.seed(seed, "Mersenne-Twister", "Inversion", "Rejection")
  angle <- 2 * pi * (0:9) / 10
  outline <- cbind(1.6 * cos(angle), sin(angle))
  species <- factor(rep_len(c("north", "south"), n))
  site <- factor(rep_len(c("lake", "lake", "river", "river"), n))
  size <- exp(stats::rnorm(n, 1, 0.25))
  coords <- vapply(seq_len(n), function(i) {
    bend <- 0.08 * (species[i] == "south") + 0.05 * (site[i] == "river") + 0.06 * (log(size[i]) - 1)
    x <- outline + cbind(0, bend * outline[, 1]^2) + stats::rnorm(20, 0, 0.02)
    turn <- stats::runif(1, 0, 2 * pi)
    x <- x %*% rbind(c(cos(turn), sin(turn)), c(-sin(turn), cos(turn)))
    sweep(size[i] * x, 2, stats::rnorm(2, 0, 5), "+")
  }, outline)
  dimnames(coords)[[3]] <- paste0(species, "-", seq_len(n))
  list(coords = coords, species = species, site = site, size = size, links = cbind(1:10, c(2:10, 1)))
}
