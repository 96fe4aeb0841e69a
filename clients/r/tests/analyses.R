# Analyses of made shapes, beside independent computations in R and beside the operations of the service on raw shapes.
source(file.path("support", "helper.R"))
need_service("analyses")

made <- example_shapes()
n <- 40
own <- procrustes(made$coords)
shapes <- gpa(made$coords)
check("a superimposition is that of an independent one", near(distances(shapes$coords)[-1, 1], distances(own$coords)[-1, 1], 1e-8))
check("so are centroid sizes", near(shapes$Csize, own$Csize, 1e-12))
check("and the mean", abs(sum(shapes$consensus^2) - 1) < 1e-12 && near(as.vector(dist(shapes$consensus)), as.vector(dist(own$mean)), 1e-8))
check("names of shapes stay", identical(dimnames(shapes$coords)[[3]], names(shapes$Csize)) && names(shapes$Csize)[2] == "south-2")
projected <- gpa(made$coords, alignment = "projection")
check("the closed form differs by the mean only", near(sum((projected$coords - as.vector(projected$consensus))^2), sum((shapes$coords - as.vector(shapes$consensus))^2), 1e-4))
rigid <- gpa(made$coords, "rigid")
check("a rigid superimposition keeps sizes", near(apply(rigid$coords, 3, function(x) sqrt(sum(x^2))), own$Csize, 1e-9))
set.seed(3)
solid <- array(rnorm(6 * 3 * 15, 0, 0.05), c(6, 3, 15)) + as.vector(matrix(rnorm(18), 6))
check("in space", near(distances(gpa(solid)$coords)[-1, 1], distances(procrustes(solid)$coords)[-1, 1], 1e-8))

arch <- function(k) {
  at <- seq(0, 1, length.out = 9)
  at <- at + 0.3 * sin(k) * at * (1 - at)
  rbind(cbind(4 * at, sin(pi * at) + 0.02 * sin(k * at)), c(0.5, -1 - 0.1 * sin(k)), c(3.5, -1), c(2, -2 + 0.1 * cos(k)))
}
arches <- array(unlist(lapply(1:6, arch)), c(12, 2, 6))
table <- cbind(before = 1:7, slide = 2:8, after = 3:9)
slid <- gpa(arches, curves = table)
check("semilandmarks slide until nothing changes", slid$slid$converged && max(abs(colMeans(slid$slid$displacements))) < 1e-12)
spread <- function(x) sum((x$coords - as.vector(x$consensus))^2)
check("and shapes lie nearer to each other", spread(gpa(arches, curves = table, ProcD = TRUE)) < spread(gpa(arches)))
check("rows of points that do not exist are refused", grepl("before, slide, after", conditionMessage(refusal(gpa(arches, curves = cbind(1, 2, 99))))))

components <- pca(shapes)
peer <- prcomp(t(matrix(shapes$coords, ncol = n)))
check("components are those of prcomp", near(components$sdev[1:10], peer$sdev[1:10], 1e-9))
check("so are scores, but for their signs", near(abs(components$x[, 1:3]), abs(peer$x[, 1:3]), 1e-6))
check("and axes", near(abs(components$rotation[, 1]), abs(peer$rotation[, 1]), 1e-6))
check("parts sum to one", abs(sum(components$explained) - 1) < 1e-9 && near(components$total, sum(peer$sdev^2), 1e-9))
body <- sub("}$", "", jsonlite::toJSON(list(representation = list(kind = "landmarks", dimension = 2, points = 10), transformation = "similarity",
  alignment = "partial_procrustes", tangent = TRUE), auto_unbox = TRUE))
whole <- shapelex_request("POST", "/v1/pca", paste0(body, ",\"shapes\":[", paste0("{\"points\":", asNamespace("shapelexr")$points_json(made$coords), "}", collapse = ","), "]}"))
check("they are those of the service on raw shapes", near(components$explained[1:10], whole$pca$explained[1:10], 1e-9))
check("a few components", ncol(pca(shapes, 3)$x) == 3 && ncol(pca(shapes, 1)$rotation) == 1)
said <- NULL
raw <- withCallingHandlers(pca(made$coords, 2), message = function(m) { said <<- conditionMessage(m); invokeRestart("muffleMessage") })
check("raw shapes are superimposed, and a message says so", grepl("gpa", said) && near(raw$sdev, components$sdev[1:2], 1e-12))
said <- NULL
own_components <- withCallingHandlers(pca(own$coords, 2), message = function(m) said <<- conditionMessage(m))
check("superimposed ones are taken as they are", is.null(said))

fit <- lm_shape(shapes ~ log(Csize) + species * site, made, iter = 199)
wanted <- sequential(shapes$coords, ~ log(Csize) + species * site, c(made, list(Csize = shapes$Csize)))
table <- anova(fit)
check("sums of squares are those of lm", near(table$SS[1:4], wanted, 1e-9), table$SS[1:4])
check("degrees of freedom", identical(table$Df, c(1, 1, 1, 1, 35, 39)), table$Df)
check("the total is that of the coordinates", near(table["Total", "SS"], sum((shapes$coords - as.vector(rowMeans(shapes$coords, dims = 2)))^2), 1e-9))
check("the columns are those of the table of procD.lm", identical(names(table), c("Df", "SS", "MS", "Rsq", "F", "Z", "Pr(>F)")))
check("p counts the observed order", all(table[1:4, "Pr(>F)"] >= 1 / 200) && fit$terms$permutations[1] == 199)
printed <- capture.output(print(summary(fit)))
check("the table is printed", any(grepl("^species:site +1 ", printed)) && any(grepl("Pr\\(>F\\)", printed)) && any(grepl("^Residuals +35", printed)), printed)
printed <- paste(capture.output(print(table)), collapse = " ")
check("with stars", grepl("Signif. codes", printed))
orthogonal <- lm(t(matrix(shapes$coords, ncol = n)) ~ log(shapes$Csize) + made$species * made$site)
check("coefficients are those of lm", near(as.vector(fit$coefficients[[2]]), coef(orthogonal)[2, ], 1e-7))
at <- expand.grid(species = c("north", "south"), site = c("lake", "river"))
at$Csize <- mean(shapes$Csize)
found <- predict(fit, at)
check("predictions too", near(as.vector(found$shapes[, , 4]), colSums(coef(orthogonal) * c(1, log(mean(shapes$Csize)), 1, 1, 1)), 1e-7))
check("a level that there is none of has its place", any(grepl("^/at/0", refusal(predict(fit, data.frame(species = "east")))$errors$pointer)))
check("the same seed gives the same table", identical(lm_shape(shapes ~ species, made, iter = 99)$table, lm_shape(shapes ~ species, made, iter = 99)$table))
check("another seed another p", !identical(lm_shape(shapes ~ size, made, iter = 999, seed = 1)$table$Z, lm_shape(shapes ~ size, made, iter = 999, seed = 2)$table$Z))

# A factor whose levels are digits, one with levels in another order, logical values, texts, a name with a blank.
made$plot <- factor(rep(c("01", "2", "33", "4"), 10))
made$big <- made$size > 2
made$`sea side` <- ifelse(made$species == "north", "a", "b")
check("digits as levels are a factor", lm_shape(shapes ~ plot, made, iter = 19)$table["Residuals", "Df"] == 36)
plots <- predict(lm_shape(shapes ~ plot, made, iter = 0), data.frame(plot = c("01", "33")))
check("and are predicted by their names", near(as.vector(plots$shapes[, , 2]), as.vector(rowMeans(shapes$coords[, , made$plot == "33"], dims = 2)), 1e-9))
ordered <- lm_shape(shapes ~ species, within(made, species <- factor(species, c("south", "north"))), iter = 0)
check("the first level is the reference", identical(names(ordered$coefficients)[2], "speciesnorth"), names(ordered$coefficients))
check("logical values are a factor", lm_shape(shapes ~ big, made, iter = 0)$table$Df[1] == 1)
check("a name with a blank", lm_shape(shapes ~ `sea side`, made, iter = 0)$table$Df[1] == 1)
local <- made$size
check("variables are found where the formula is written", lm_shape(shapes ~ local, iter = 0)$table$Df[1] == 1)
made$size[3] <- NA
check("a missing value is refused", inherits(refusal(lm_shape(shapes ~ size, made, iter = 0)), "shapelex_problem"))
check("or left out", lm_shape(shapes ~ size, made, iter = 0, missing = "skip")$table["Total", "Df"] == 38)
made$late <- seq_len(n) > 13 & made$species == "north"
check("types differ where the design is unbalanced", {
  types <- lapply(c("I", "II", "III"), function(type) lm_shape(shapes ~ late + species * site, made, iter = 0, SS.type = type)$table$SS)
  !isTRUE(all.equal(types[[1]], types[[2]])) && !isTRUE(all.equal(types[[2]], types[[3]]))
})
made$subject <- factor(rep(1:20, each = 2))
blocked <- lm_shape(shapes ~ subject + species, made, iter = 99, block = made$subject)
check("blocks are exchanged within", any(grepl("within", blocked$terms$exchange)), blocked$terms$exchange)
stratified <- lm_shape(shapes ~ species, made, iter = 99, strata = made$site)
check("strata", !identical(stratified$table$Z, lm_shape(shapes ~ species, made, iter = 99)$table$Z))
made$year <- factor(rep(c("a", "b", "c", "d", "e"), each = 8))
nested <- lm_shape(shapes ~ site / year, made, iter = 99)
other <- anova(nested, error = c("site:year", "Residuals"))
check("another error term has another F", near(other["site", "F"], nested$table["site", "MS"] / nested$table["site:year", "MS"], 1e-9), other["site", "F"])
check("so by names", identical(anova(nested, error = c(site = "site:year")), other))
random <- lm_shape(shapes ~ species + (1 | year), made, iter = 99)
check("groups as an error term", "year" %in% rownames(random$table) || any(grepl("year", rownames(random$table))), rownames(random$table))

pair <- compare(shapes, made$species, iter = 199)
single <- lm_shape(shapes ~ species, made, iter = 0)$table
check("a comparison of two groups is the model of one factor", near(pair$overall$F, single$F[1], 1e-9) && near(pair$overall$Rsq, single$Rsq[1], 1e-9))
means <- sapply(levels(made$species), function(level) rowMeans(shapes$coords[, , made$species == level], dims = 2))
check("means are those of the groups", near(as.vector(pair$means), as.vector(means), 1e-9))
check("so is their distance", near(pair$pairs$distance, sqrt(sum((means[, 1] - means[, 2])^2)), 1e-9))
check("and their scatter", near(pair$groups$variance[1], mean(colSums((shapes$coords[, , made$species == "north"] - means[, 1])^2, dims = 2)), 1e-9))
four <- compare(shapes, made$species:made$site, iter = 99)
check("four groups have six pairs", nrow(four$pairs) == 6 && four$overall$Df == 3 && all(four$pairs$p.holm >= four$pairs$p))
check("effects have a row a point", nrow(four$effects[[1]]) == 10)
check("groups by numbers", nrow(compare(shapes, rep(1:2, 20), iter = 19)$groups) == 2)

allometry <- regress(shapes, log(shapes$Csize), iter = 199)
single <- lm_shape(shapes ~ log(Csize), iter = 0)$table
check("a regression is the model of one number", near(allometry$table$F, single$F[1], 1e-9) && near(allometry$table$Rsq, single$Rsq[1], 1e-9))
slope <- coef(lm(t(matrix(shapes$coords, ncol = n)) ~ log(shapes$Csize)))[2, ]
check("its slope is that of lm", near(as.vector(allometry$slope), slope, 1e-7))
score <- drop(crossprod(matrix(shapes$coords - as.vector(rowMeans(shapes$coords, dims = 2)), ncol = n), slope / sqrt(sum(slope^2))))
check("scores are projections on it", near(allometry$RegScore, score, 1e-7))
made$plot <- factor(rep(c("01", "2", "33", "4"), each = 10))
given <- regress(shapes, log(shapes$Csize), data.frame(species = made$species, plot = made$plot), iter = 99)
last <- lm_shape(shapes ~ species + plot + log(Csize), made, iter = 0, int.first = TRUE)$table
check("covariates are removed first", near(given$table$F, last["log(Csize)", "F"], 1e-9), given$table$F, last["log(Csize)", "F"])

grDevices::pdf(NULL)
for (draw in list(
  function() plot(shapes, links = made$links, label = TRUE), function() plot(gpa(solid)), function() plot(components, groups = made$species),
  function() plot(components, "shapes", axis1 = 2, links = made$links), function() plot(components, "variance"), function() plot(pca(solid), "shapes"),
  function() plot(four, mag = 2, links = made$links), function() plot(allometry, groups = made$species), function() plot(allometry, "shapes"),
  function() plot(fit, links = made$links), function() plot(fit, "permutations"), function() plot_change(shapes$consensus, shapes$coords[, , 1]),
  function() plot_change(solid[, , 1], solid[, , 2]), function() plot_change(solid[, , 1], solid[, , 2], "vector"),
  function() plot_change(shapes$consensus, shapes$consensus, "vector"), function() plot_change(shapes$consensus, shapes$coords[, , 1], "points")
)) suppressMessages(check(paste("a picture:", deparse(body(draw))[1]), { draw(); TRUE }))
check("links that lead nowhere are refused", grepl("from 1 to 10", conditionMessage(refusal(plot(shapes, links = cbind(1, 11))))))
invisible(grDevices::dev.off())
for (result in list(shapes, summary(shapes), components, summary(components), four, summary(four), allometry, summary(allometry), fit, summary(fit))) {
  check(paste("print of", class(result)[1]), length(capture.output(print(result))) > 2)
}
done("analyses")
