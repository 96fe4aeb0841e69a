# What needs no service: arrays, bodies, refusals of arguments, splines.
source(file.path("support", "helper.R"))
internal <- asNamespace("shapelexr")

a <- array(seq_len(24) + 0.25, c(4, 2, 3))
bytes <- internal$npy(a)
header <- 10 + sum(as.integer(bytes[9:10]) * c(1, 256))
check("the numbers of an NPY file begin at a multiple of 64", header %% 64 == 0, header)
check("its length is that of the numbers", length(bytes) == header + 8 * 24, length(bytes))
numbers <- readBin(bytes[-seq_len(header)], "double", 24, endian = "little")
check("coordinates of a point stand side by side", identical(numbers[1:4], c(a[1, 1, 1], a[1, 2, 1], a[2, 1, 1], a[2, 2, 1])), numbers[1:4])
check("shapes stand one after the other", numbers[9] == a[1, 1, 2], numbers[9])

x <- array(c(pi, exp(1), 1 / 3, 1e-300, -0.1, 1e22), c(1, 2, 3))
read <- jsonlite::fromJSON(paste0("[", paste(internal$points_json(x), collapse = ","), "]"))
check("JSON keeps all digits", identical(as.vector(aperm(read, c(2, 3, 1))), as.vector(x)), as.vector(read))
x[1, 2, 2] <- NA
check("a missing coordinate is null", grepl("null", internal$points_json(x)[2]))

made <- example_shapes()
set.seed(7)
first <- runif(1)
set.seed(7)
again <- example_shapes()
check("made shapes are the same every time", identical(made, again))
check("and leave the random numbers of the session alone", identical(runif(1), first))

fit <- procrustes(made$coords)
check("raw shapes are not superimposed", !internal$is_superimposed(made$coords))
check("superimposed shapes are", internal$is_superimposed(fit$coords))
check("after two rounds they are too", internal$is_superimposed(procrustes(made$coords, 2)$coords))
turned <- fit$coords
turned[, , 1] <- turned[, 2:1, 1]
check("a turned one is not", !internal$is_superimposed(turned))
solid <- array(rnorm(5 * 3 * 8), c(5, 3, 8)) * 0.1 + as.vector(matrix(rnorm(15), 5))
check("in space too", internal$is_superimposed(procrustes(solid)$coords) && !internal$is_superimposed(solid))

check("levels that are numbers are texts", identical(internal$level_texts(c("01", "2")), c("level 01", "level 2")) && internal$level_texts("a1") == "a1")
check("a matrix is refused", grepl("expected a numeric array of points × coordinates × shapes, got matrix of 2 × 2",
                                   conditionMessage(refusal(gpa(matrix(1:4, 2), server = NULL)))))
check("a list of matrices is an array", identical(dim(internal$shape_array(list(diag(2), diag(2)))), c(2L, 2L, 2L)))
check("values of another number are refused", grepl("expected 3 values, one a shape, got 2", conditionMessage(refusal(internal$attribute(1:2, "x", 3)))))
check("dates are refused", grepl("got Date", conditionMessage(refusal(internal$attribute(Sys.Date(), "x", 1)))))
check("a program that is not there", inherits(refusal(shapelex_server(program = "none")), "shapelex_unreachable"))
check("an address that is none", grepl("expected an address", conditionMessage(refusal(shapelex_server(url = "none")))))
check("a service that is not there", inherits(refusal(shapelex_server(url = "http://127.0.0.1:9")), "shapelex_unreachable"))

ref <- cbind(c(0, 1, 0, 1, 0.5), c(0, 0, 1, 1, 0.6))
target <- ref
target[5, ] <- c(0.6, 0.4)
warp <- internal$thin_plate(ref, target)
check("the spline takes the reference to the target", max(abs(warp(ref) - target)) < 1e-12, max(abs(warp(ref) - target)))
shear <- internal$thin_plate(ref, ref %*% rbind(c(1, 0.3), c(0, 2)))
there <- cbind(c(3, -1), c(0.2, 5))
check("an affine map is itself", max(abs(shear(there) - there %*% rbind(c(1, 0.3), c(0, 2)))) < 1e-10)
# No service was asked: none is to be closed.
Sys.setenv(SHAPELEXR_PROGRAM = "none", SHAPELEXR_URL = "")
done("arrays")
