/* Dimension scales as the HDF5 convention has them (and as H5DSattach_scale writes them),
 * but each attribute once: H5DSattach_scale reads, deletes and writes a scale's whole list
 * for every dataset that is added to it, which cost more than all else in a new file.
 */
#include <hdf5.h>
#include <stdlib.h>
#include <string.h>

/* One entry of a scale's REFERENCE_LIST: a dataset, and which of its dimensions. */
typedef struct {
    hobj_ref_t dataset;
    int dimension;
} reference_t;

/* Where an object lies in its file, as references have it; 0: it cannot be told. */
uint64_t castnet_reference(hid_t object)
{
    hobj_ref_t reference = 0;
    if (H5Rcreate(&reference, object, ".", H5R_OBJECT, (hid_t)-1) < 0) return 0;
    return (uint64_t)reference;
}

/* Name a dataset's dimensions, in C's order, by the references of their scales. */
int castnet_name_dimensions(hid_t dataset, int rank, const uint64_t *scale)
{
    hvl_t list[H5S_MAX_RANK];
    hobj_ref_t reference[H5S_MAX_RANK];
    hsize_t shape = (hsize_t)rank;
    int status = -1;
    if (rank < 1 || rank > H5S_MAX_RANK) return -1;
    for (int i = 0; i < rank; i++) {
        reference[i] = (hobj_ref_t)scale[i];
        list[i].len = 1;
        list[i].p = &reference[i];
    }
    hid_t type = H5Tvlen_create(H5T_STD_REF_OBJ);
    hid_t space = H5Screate_simple(1, &shape, NULL);
    hid_t attribute = H5Acreate2(dataset, "DIMENSION_LIST", type, space, H5P_DEFAULT, H5P_DEFAULT);
    if (attribute >= 0) {
        status = H5Awrite(attribute, type, list) < 0 ? -1 : 0;
        H5Aclose(attribute);
    }
    H5Sclose(space);
    H5Tclose(type);
    return status;
}

/* The entries that a scale has already; NULL where it has none. */
static reference_t *old_references(hid_t scale, hid_t type, size_t *n)
{
    reference_t *list = NULL;
    *n = 0;
    if (H5Aexists(scale, "REFERENCE_LIST") <= 0) return NULL;
    hid_t attribute = H5Aopen(scale, "REFERENCE_LIST", H5P_DEFAULT);
    hid_t space = H5Aget_space(attribute);
    hssize_t points = H5Sget_simple_extent_npoints(space);
    if (points > 0) list = malloc((size_t)points * sizeof *list);
    if (list != NULL && H5Aread(attribute, type, list) >= 0) *n = (size_t)points;
    H5Sclose(space);
    H5Aclose(attribute);
    return list;
}

/* Tell the scale at `scale` in a file which datasets use it: n of them, with the number of
 * the dimension in C's order. `open` is the scale's dataset, or negative where it is not open. */
int castnet_refer_back(hid_t file, uint64_t scale, hid_t open, int n, const uint64_t *dataset, const int *dimension)
{
    hobj_ref_t reference = (hobj_ref_t)scale;
    int status = -1;
    size_t n_old;
    hid_t object = open >= 0 ? open : H5Rdereference2(file, H5P_DEFAULT, H5R_OBJECT, &reference);
    if (object < 0) return -1;
    hid_t type = H5Tcreate(H5T_COMPOUND, sizeof(reference_t));
    H5Tinsert(type, "dataset", HOFFSET(reference_t, dataset), H5T_STD_REF_OBJ);
    H5Tinsert(type, "dimension", HOFFSET(reference_t, dimension), H5T_NATIVE_INT);
    reference_t *old = old_references(object, type, &n_old);
    reference_t *list = calloc(n_old + (size_t)n, sizeof *list);
    if (list != NULL) {
        if (n_old > 0) memcpy(list, old, n_old * sizeof *list);
        for (int i = 0; i < n; i++) {
            list[n_old + (size_t)i].dataset = (hobj_ref_t)dataset[i];
            list[n_old + (size_t)i].dimension = dimension[i];
        }
        hsize_t shape = n_old + (hsize_t)n;
        hid_t space = H5Screate_simple(1, &shape, NULL);
        if (old != NULL) H5Adelete(object, "REFERENCE_LIST");
        hid_t attribute = H5Acreate2(object, "REFERENCE_LIST", type, space, H5P_DEFAULT, H5P_DEFAULT);
        if (attribute >= 0) {
            status = H5Awrite(attribute, type, list) < 0 ? -1 : 0;
            H5Aclose(attribute);
        }
        H5Sclose(space);
    }
    free(list);
    free(old);
    H5Tclose(type);
    if (object != open) H5Oclose(object);
    return status;
}
