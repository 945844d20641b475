/* Functions on arrays that backhoe_planner has in plain Python too, where each is explained. */
#define BACKHOE_MODULE
#include "arrays.h"

#define ENTRY(name) {#name, (PyCFunction)(void (*)(void))name, METH_FASTCALL, NULL},

static PyMethodDef functions[] = {FUNCTIONS(ENTRY){NULL, NULL, 0, NULL}};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "backhoe_planner_native", "Compiled functions of backhoe_planner.", -1, functions,
    NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit_backhoe_planner_native(void)
{
    import_array();
    PyObject *made = PyModule_Create(&module);
    if (made && PyModule_AddIntConstant(made, "INTERFACE", 3) < 0) {
        Py_DECREF(made);
        return NULL;
    }
    return made;
}
