MODULE cubes(SYSMODULE)
    LOCAL PERS tooldata pinza:=[TRUE,[[0,0,206],[0.965926,0,0,0.258819]],[1.8,[2.7,0,84.4],[1,0,0,0],0.033,0.034,0.007]];
    LOCAL CONST robtarget cube{3}:=[[[24.83,308.61,161.01],[0,0,-1,0],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]],[[-51.17,308.79,159.01],[0,0,-1,0],[1,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]],
        [[-126.15,308.16,159.00],[0,0,-1,0],[1,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]];
    PROC pick(num n)
        FOR i FROM 1 TO 3 DO
            MoveL cube{i},v200,z5,pinza;
        ENDFOR
        MoveL cube{2},v200,z5,pinza;
        MoveL RelTool(cube{n},0,0,-50),v200,z5,pinza;
    ENDPROC
ENDMODULE
