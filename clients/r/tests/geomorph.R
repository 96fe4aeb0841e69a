# Salamander heads (Adams 2004, 2010), beside a converged superimposition, one that stops early, and tables of geomorph 4.0.8 and RRPP 2.1.2.
source(file.path("support", "helper.R"))
need_service("geomorph")
file <- beside("SHAPELEXR_DATA", "landmarks-plethodon", "landmarks.csv")
if (is.null(file)) skip("the tables of geomorph, landmarks-plethodon is not beside the project")

heads <- read_shapes(file)
shapes <- gpa(heads)
converged <- procrustes(heads$coords)
check("coordinates equal a converged superimposition to 1e-8", near(distances(shapes$coords)[-1, 1], distances(converged$coords)[-1, 1], 1e-8))
check("the first centroid size is that which geomorph prints", abs(shapes$Csize[1] - 15.2269) < 5e-5, shapes$Csize[1])
fit <- lm_shape(shapes ~ species * site, heads$data)
ss <- function(a) c(sequential(a, ~ species * site, heads$data), sum((a - as.vector(rowMeans(a, dims = 2)))^2))
check("sums of squares equal those of converged coordinates to 1e-8", near(fit$table$SS[c(1:3, 5)], ss(converged$coords), 1e-8), fit$table$SS)
# geomorph stops after two rounds here.
early <- ss(procrustes(heads$coords, 2)$coords)
check("and those of two rounds to 1e-6", near(fit$table$SS[c(1:3, 5)], early, 1e-6), fit$table$SS[c(1:3, 5)] / early - 1)
check("the total", near(fit$table["Total", "SS"], 0.19693973282542, 1e-8), fit$table["Total", "SS"])
check("F as geomorph prints it", identical(sprintf("%.3f", fit$table$F[1:3]), c("14.544", "32.000", "15.353")), fit$table$F)
check("p of 999 permutations", all(fit$table[1:3, "Pr(>F)"] == 0.001), fit$table[1:3, "Pr(>F)"])
third <- suppressWarnings(lm_shape(shapes ~ species * site, heads$data, iter = 199, SS.type = "III", contrasts = "treatment"))
check("type III at the reference level, as geomorph has it", identical(sprintf("%.3f", third$table$F[1:3]), c("1.471", "22.747", "15.353")), third$table$F)
components <- pca(shapes)
check("parts of the variance", near(components$explained[1:3], c(0.36743332, 0.31023328, 0.08200540), 3e-8), components$explained[1:3])
check("of two species", {
  species <- compare(shapes, heads$data$species, iter = 99)
  near(species$overall$F, 6.630401475616, 1e-6) && near(species$overall$Rsq, 0.148562391079, 1e-7)
})
check("on size", near(regress(shapes, log(shapes$Csize), iter = 99)$table$Rsq, 0.045161234437, 1e-5))

vectors <- beside("SHAPELEXR_VECTORS", "models", "anova_real.json")
if (is.null(vectors)) {
  cat("SKIPPED: R, the vectors of linear models, they are not beside the package\n")
} else {
  cases <- jsonlite::fromJSON(vectors, simplifyVector = FALSE)$cases
  cases <- Filter(function(case) case$set == "landmarks-plethodon" && case$alignment == "tangent" && is.null(case$error) && is.null(case$strata), cases)
  check("vectors of plethodon", length(cases) >= 3, length(cases))
  for (case in cases) {
    terms <- sub("~ ", "", gsub("log_size|log_centroid_size", "log(Csize)", case$formula))
    formula <- stats::as.formula(paste("shapes ~", terms))
    found <- suppressWarnings(lm_shape(formula, heads$data, iter = case$permutations, SS.type = case$type, contrasts = case$contrasts))$table
    wanted <- vapply(case$table, function(row) row$ss, 0)
    check(paste("vector:", case$formula, case$type, case$contrasts), near(found$SS, wanted, 1e-8), max(abs(found$SS / wanted - 1)))
  }
}

pupfish <- beside("SHAPELEXR_DATA", "landmarks-pupfish", "landmarks.csv")
if (!is.null(pupfish)) {
  fish <- read_shapes(pupfish)
  data <- fish$data
  fit <- lm_shape(fish ~ log(centroid_size) + sex * population, data, iter = 199)
  check("given coordinates are taken as they are: the table of the manual of RRPP",
        identical(sprintf("%.4f", fit$table$F[1:4]), c("28.5232", "15.4933", "15.5860", "6.0105")), fit$table$F)
} else {
  cat("SKIPPED: R, the table of pupfish, they are not beside the project\n")
}
done("geomorph")
